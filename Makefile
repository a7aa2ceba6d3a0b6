# `make wipe` and `make test` set up everything they need in .venv.
ARGS ?=
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DOCS := $(VENV)/.docs
PYTHON ?= $(shell command -v python3.12 || command -v python3)

.PHONY: help wipe teach test test-quick lint bench readme wheel docs clean

help:
	@echo "make wipe   learn from the bundled demonstration and wipe a board"
	@echo "            (options: make wipe ARGS='--duration 30')"
	@echo "make teach  guide the arm on a page in the browser, press learn, and it continues"
	@echo "make test   run the tests          make lint   check style and types"
	@echo "make bench  measure speed          make docs   build the site in out/site"
	@echo "make readme do what the README says, with the wheel in an empty folder"
	@echo "make wheel  build the wheel, here"
	@echo "make clean  remove the environment"

# uv installs its own Python 3.12; without uv, Python 3.12 must be installed.
$(STAMP): pyproject.toml constraints.txt .python-version
	@echo "making an environment in $(VENV), once; it takes a minute or two"
	@if command -v uv >/dev/null 2>&1; then \
	    rm -rf $(VENV) && uv venv --quiet --seed $(VENV); \
	else \
	    "$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null || { \
	        echo "fmp-drake needs Python 3.12 or newer, but '$(PYTHON)' is" \
	            "$$("$(PYTHON)" --version 2>&1)." \
	            "Install Python 3.12 (or uv, which installs it), or name one:" \
	            "make PYTHON=/path/to/python3.12" >&2; exit 1; }; \
	    { [ ! -L $(VENV) ] || rm $(VENV); } && "$(PYTHON)" -m venv --clear $(VENV); \
	fi
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
	    --constraint constraints.txt --editable '.[dev]'
	@touch $(STAMP)

$(DOCS): $(STAMP)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
	    --constraint constraints.txt --editable '.[docs]'
	@touch $(DOCS)

# Scripts such as $(BIN)/fmp-drake name the folder in which they were installed, which may have
# been moved or copied.
wipe: $(STAMP)
	@$(BIN)/python -m fmp_drake wipe $(ARGS)

teach: $(STAMP)
	@$(BIN)/python -m fmp_drake teach $(ARGS)

# Rewritten assertions are kept: rewriting them takes each process six seconds.
test: export PYTHONDONTWRITEBYTECODE :=
test: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist loadscope --no-loadscope-reorder \
	    --max-worker-restart 0 --reruns 1 $(ARGS)

test-quick: override ARGS += -m 'not slow and not browser' \
    tests/primitives tests/systems tests/test_layers.py
test-quick: test

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/python -m mypy
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.citation-file-format CITATION.cff

bench: $(STAMP)
	@mkdir -p out
	$(BIN)/python -m pytest tests/benchmarks -q --benchmark-only \
	    --benchmark-columns=min,median,iqr,rounds \
	    --benchmark-json=out/benchmark.json $(ARGS)
	@echo "The figures are in out/benchmark.md, out/growth.png and out/benchmark.json."

wheel: $(STAMP)
	$(BIN)/python -m build --wheel --outdir .

readme: $(STAMP)
	$(BIN)/python tests/try_readme.py

docs: $(DOCS)
	$(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going \
	    examples/site out/site $(ARGS)
	$(BIN)/jupyter execute examples/site/gallery/0[123]_*.ipynb
	@echo "The site is out/site/index.html."

clean:
	rm -rf $(VENV) out dist
