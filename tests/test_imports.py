"""Heavy libraries cannot sneak in: they are made unimportable, and everything that must do without them is imported.

Looking for `torch` in sys.modules afterwards would prove nothing: an import that fails is also absent there.
"""

import pkgutil
import subprocess
import sys

import model
import service

HEAVY = ("torch", "pandas", "pyarrow", "onnx", "onnxscript", "scipy", "matplotlib", "training", "data_synth")
BLOCK = f"import sys\nfor name in {HEAVY!r}: sys.modules[name] = None\n"


def without_heavy(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", BLOCK + code], capture_output=True, text=True, check=False)


def test_blocking_works() -> None:
    assert "ModuleNotFoundError" in without_heavy("import torch").stderr


def test_model_and_service_import_without_heavy_libraries() -> None:
    names = ["model." + m.name for m in pkgutil.iter_modules(model.__path__) if m.name != "network"]
    names += [m.name for m in pkgutil.walk_packages(service.__path__, "service.") if ".migrations." not in m.name]
    names.append("service.store.schema")  # loads the migrations
    assert len(names) > 30
    done = without_heavy("".join(f"import {name}\n" for name in names))
    assert done.stderr == ""
    assert done.returncode == 0


def test_only_the_network_needs_torch_in_model() -> None:
    assert "ModuleNotFoundError" in without_heavy("import model.network").stderr


def test_the_command_line_lists_all_commands_without_heavy_libraries() -> None:
    code = "from model.cli import main\nsys.argv = ['thermotrue', '--help']\nmain()"
    done = subprocess.run(
        [sys.executable, "-c", BLOCK.replace(", 'training', 'data_synth'", "") + code],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0
    assert "compensate" in done.stdout
