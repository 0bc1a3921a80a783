ARG PYTHON_IMAGE=python:3.11-slim-bookworm

FROM ${PYTHON_IMAGE} AS build
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY model model
COPY training training
COPY service service
COPY data_synth data_synth
# The per-position path is compiled here, so that no start waits for it; a processor of another kind compiles it anew.
ENV NUMBA_CACHE_DIR=/opt/thermotrue/compiled
RUN python3 -m venv /opt/thermotrue \
 && /opt/thermotrue/bin/python -m pip install --quiet --no-cache-dir --constraint constraints.txt '.[postgresql]' \
 && cd / && /opt/thermotrue/bin/python -c 'import model.kernel' \
 && chown -R 10001 /opt/thermotrue/compiled

FROM ${PYTHON_IMAGE}
RUN useradd --system --uid 10001 --no-create-home thermotrue && install --directory --owner 10001 --mode 0700 /data
COPY --from=build /opt/thermotrue /opt/thermotrue
COPY demo/vmc3 /bundles/vmc3
ENV PATH=/opt/thermotrue/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 \
    NUMBA_CACHE_DIR=/opt/thermotrue/compiled THERMOTRUE_DATA_DIR=/data
USER 10001
EXPOSE 8000
# Telemetry, thermal states, models and keys; all else may be read-only, but for /tmp.
VOLUME /data
# Liveness and not readiness: while its database is away the service corrects from memory, which a restart would lose.
HEALTHCHECK --interval=5s --timeout=3s --start-period=120s \
  CMD ["python3", "-c", "import urllib.request as u; u.urlopen('http://127.0.0.1:8000/healthz', timeout=2)"]
# Beyond loopback, since a container's port is published by whoever runs it; so callers must show a key.
CMD ["thermotrue", "serve", "/bundles/vmc3", "--host", "0.0.0.0", "--port", "8000", "--allow-plain-http"]
