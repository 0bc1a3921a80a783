"use strict";
// What the machines do now: asks the service every few seconds and keeps the last hours of the correction in memory.
const PERIOD_MS = 5000;
const KEEP_MS = 8 * 3600 * 1000;
const GOOD = new Set(["ok", "warming_up"]);
const BAD = new Set(["stale", "geometric_only"]);
const SAID = {
  ok: "compensating", warming_up: "warming up", drifting: "drifting", degraded: "degraded",
  extrapolating: "outside of what was trained", stale: "telemetry is stale", geometric_only: "geometric errors only",
};
const history = new Map();
const $ = (id) => document.getElementById(id);

async function call(path, method = "GET") {
  const key = sessionStorage.getItem("key");
  const headers = key ? { Authorization: `Bearer ${key}` } : {};
  const answer = await fetch(path, { method, headers, cache: "no-store", credentials: "omit" });
  const body = await answer.json();
  if (answer.ok) return body;
  if (answer.status === 401) $("ask").hidden = false;
  throw new Error(body.detail || `${path} answered ${answer.status}`);
}

function text(parent, tag, content, kind) {
  const element = document.createElement(tag);
  element.textContent = content;
  if (kind) element.className = kind;
  parent.append(element);
  return element;
}

function um(value) { return value === null ? "none yet" : `${value.toFixed(1)} µm`; }

function ago(time, now) {
  if (time === null) return "none yet";
  const seconds = Math.max(0, (Date.parse(now) - Date.parse(time)) / 1000); // by the machine's clock
  return seconds < 90 ? `${seconds.toFixed(0)} s ago` : seconds < 5400 ? `${(seconds / 60).toFixed(0)} min ago`
    : `${(seconds / 3600).toFixed(1)} h ago`;
}

function card(name) {
  const found = document.querySelector(`section[data-name="${CSS.escape(name)}"]`);
  if (found) return found;
  const fresh = $("machine").content.firstElementChild.cloneNode(true);
  fresh.dataset.name = name;
  fresh.querySelector("h2").textContent = name;
  fresh.querySelector("button").addEventListener("click", async () => {
    if (!confirm(`Make the present thermal state of ${name} the zero of its correction?`)) return;
    try { await call(`/v1/machines/${encodeURIComponent(name)}/datum`, "POST"); } catch (problem) { alert(problem.message); }
    refresh();
  });
  $("machines").append(fresh);
  return fresh;
}

function show(machine) {
  const place = card(machine.machine);
  const status = place.querySelector(".status");
  status.textContent = SAID[machine.status] || machine.status;
  status.className = `status ${GOOD.has(machine.status) ? "good" : BAD.has(machine.status) ? "bad" : "care"}`;
  const figures = place.querySelector(".figures");
  figures.replaceChildren();
  for (const [name, value] of [
    ["largest correction", um(machine.correction_um)],
    ["still to go", um(machine.remaining_um)],
    ["thermal part counts", `${(100 * machine.reliability).toFixed(0)} %`],
    ["telemetry", ago(machine.telemetry_time, machine.time)],
    ["network", machine.model],
  ]) {
    const pair = text(figures, "div", "");
    text(pair, "dt", name);
    text(pair, "dd", value);
  }
  const warnings = place.querySelector(".warnings");
  warnings.replaceChildren();
  for (const sentence of machine.warnings) text(warnings, "li", sentence);
  const rows = place.querySelector("tbody");
  rows.replaceChildren();
  for (const [name, sensor] of Object.entries(machine.sensors)) {
    if (!sensor.used) continue;
    const row = text(rows, "tr", "");
    text(row, "th", name).scope = "row";
    text(row, "td", sensor.taken_degC === null ? "" : sensor.taken_degC.toFixed(1));
    text(row, "td", sensor.valid_range_degC ? sensor.valid_range_degC.map((v) => v.toFixed(1)).join(" to ") : "");
    text(row, "td", sensor.fault === null ? "good" : `replaced: ${sensor.fault}`, sensor.fault === null ? "" : "care");
  }
  place.querySelector("table").hidden = rows.children.length === 0;
  const datum = machine.datum;
  const kind = datum.kind === "set" ? "set" : datum.kind === "absolute" ? "absolute" : "the first telemetry";
  place.querySelector(".datum span").textContent = `Zero of the correction: ${kind}${datum.time ? ", " + new Date(datum.time).toLocaleString() : ""}.`;
  draw(place, machine);
}

function draw(place, machine) {
  const now = Date.now();
  const points = (history.get(machine.machine) || []).filter(([when]) => when > now - KEEP_MS);
  if (machine.correction_um !== null) points.push([now, machine.correction_um]);
  history.set(machine.machine, points);
  const figure = place.querySelector("figure");
  figure.hidden = points.length < 2;
  if (figure.hidden) return;
  const most = Math.max(1, ...points.map(([, value]) => value)) * 1.1;
  const first = points[0][0];
  const line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
  line.setAttribute("points", points.map(([when, value]) =>
    `${(600 * (when - first) / Math.max(1, now - first)).toFixed(1)},${(160 - 160 * value / most).toFixed(1)}`).join(" "));
  const svg = figure.querySelector("svg");
  svg.replaceChildren(line);
  svg.setAttribute("aria-label", `largest correction since ${new Date(first).toLocaleTimeString()}, now ${um(machine.correction_um)}`);
  figure.querySelector("figcaption").textContent =
    `Largest correction on any axis since ${new Date(first).toLocaleTimeString()}; the top is ${most.toFixed(0)} µm.`;
}

async function refresh() {
  try {
    const { machines } = await call("/v1/machines");
    const names = new Set(machines.map((machine) => machine.machine));
    for (const place of document.querySelectorAll("section")) if (!names.has(place.dataset.name)) place.remove();
    machines.forEach(show);
    $("ask").hidden = true;
    const ready = await fetch("/readyz", { cache: "no-store" });
    $("state").textContent = ready.ok ? `${machines.length} served, ${new Date().toLocaleTimeString()}` : (await ready.json()).detail;
    $("state").className = ready.ok ? "" : "bad";
  } catch (problem) {
    $("state").textContent = problem.message;
    $("state").className = "bad";
  }
}

$("ask").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem("key", $("key").value.trim());
  refresh();
});
refresh();
setInterval(refresh, PERIOD_MS);
