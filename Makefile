# Two commands on a fresh machine: `make demo` and `make test`. Nothing but Python 3.11 or newer is needed beforehand.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# A worker that is done takes over the last half of what another has left: each module stays on one worker but where it
# is cut, which keeps its fixtures and compiled functions, and no worker waits for the longest module.
PYTEST := $(BIN)/python -m pytest --numprocesses=auto --maxprocesses=4 --dist=worksteal --durations=25
# Tests of the parts that take arrays from outside, whose types and shapes are checked as they run (pyright checks the rest),
# and of what documents show.
SECOND := $(addprefix tests/,arms recordings test_notebooks.py test_screens.py)

.PHONY: demo test test-slow test-long docs screens made notebooks benchmark installed-locked lock clean

demo: $(VENV)/installed
	$(BIN)/lite6jax demo

test: $(VENV)/installed-test
	$(PYTEST) -m "not long" $(addprefix --ignore=,$(SECOND))

# The second stage of .ci/run: arms and recordings with types and shapes checked in each call, and what documents show.
test-slow: $(VENV)/installed-test
	CHECK_TYPES=1 $(PYTEST) $(SECOND)

# Statistics over many draws, and whole commands on large files: after each change on the forge, and before a release.
test-long: $(VENV)/installed-test
	$(PYTEST) -m long

# The documentation, in the folder site: built strictly, and looked through for links that lead nowhere.
docs: $(VENV)/installed-test
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	$(BIN)/python -m docs.hooks.site_check site

# What the commands in the documentation print now, written into its pages and the README.
screens: $(VENV)/installed-test
	$(BIN)/python -m docs.hooks.screens

# What the code says of itself, written into the pages: help of the commands, columns, keys, arms, effects, public names.
made: $(VENV)/installed-test
	$(BIN)/python -m docs.hooks.made

# The notebooks with what they print and draw now; those of real arms where LITE6JAX_REAL names the folder of the data.
notebooks: $(VENV)/installed-test
	$(BIN)/python -m docs.hooks.notebooks

benchmark: $(VENV)/installed-test
	$(BIN)/python -m benchmarks

# Made anew when what is to be installed has changed. The package itself is linked, so that its code needs no stamp.
$(VENV)/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "error: $(PYTHON) is older than 3.11; name a newer one: make PYTHON=python3.12" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	touch $@

# The same tools as they were locked, each with its hash: what the forge tests.
installed-locked: pyproject.toml .ci/requirements.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --require-hashes --requirement .ci/requirements.txt
	$(BIN)/python -m pip install --quiet --no-deps --editable .
	touch $(VENV)/installed $(VENV)/installed-test

# Of the newest versions that pyproject.toml accepts, for Python 3.11 and newer on any system.
lock:
	$(PYTHON) -m venv $(VENV)-lock
	$(VENV)-lock/bin/python -m pip install --quiet uv
	$(VENV)-lock/bin/uv pip compile pyproject.toml --extra test --universal --python-version 3.11 --generate-hashes \
		--upgrade --no-emit-index-url --quiet --custom-compile-command "make lock" --output-file .ci/requirements.txt

clean:
	rm -rf $(VENV) build dist site *.egg-info .pytest_cache .ruff_cache .hypothesis
