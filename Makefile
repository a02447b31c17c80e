# Every target sets up what it needs: Python 3.11 or newer and make are enough.
#   make demo                      analyse the bundled campaign
#   make test PYTHON=python3.12    with another interpreter (make clean-venv first, or VENV=.venv-312)

PYTHON ?= python3
VENV ?= .venv
JOBS ?= 2
EXTRAS ?= test
PYTEST_ARGS ?=
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# One thread a process: the suite, the chains and the studies run in parallel by processes.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# The exact versions that are tested together: one list for 3.11, one for everything newer.
CONSTRAINTS := "constraints-$$($(BIN)/python -c \
  'import sys; print("3.11" if sys.version_info < (3, 12) else "3.12")').txt"

.DEFAULT_GOAL := help
.PHONY: help install demo test test-slow record lint format bench study coverage paper docs screenshot data dist \
  check-dist clean clean-venv

help:
	@echo "make install   $(VENV) with the package and everything the tests need"
	@echo "make demo      analyse the bundled campaigns, report in build/demo"
	@echo "make test      the test suite (PYTEST_ARGS=... is handed on)"
	@echo "make test-slow  the tests that take more than five seconds each; make test leaves them out"
	@echo "make record    every recorded result once more, each difference by name (CASES=folder: more)"
	@echo "make lint      formatter and linter in check mode, types"
	@echo "make format    let the formatter and the linter mend what they can"
	@echo "make bench     speed of likelihood, posterior and whole commands"
	@echo "make study     the long studies behind the paper (JOBS=$(JOBS) processes)"
	@echo "make coverage  which branches the tests see, by room (half an hour)"
	@echo "make paper     the manuscript as PDF, from the studies' outputs"
	@echo "make docs      the documentation pages"
	@echo "make screenshot  the README's picture of the report's first page (needs Chromium)"
	@echo "make data      rebuild data/reference and data/withheld bit for bit"
	@echo "make dist      wheel and source archive in dist/"
	@echo "make check-dist  install the wheel into new environments, run it there (QUICK=1: one)"
	@echo "make clean     remove build results and caches (clean-venv: the environment)"

install: $(STAMP)

$(STAMP): pyproject.toml $(wildcard constraints-*.txt)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "bayes_sensor needs Python 3.11 or newer, but '$(PYTHON)' is older or does not run;" \
	       "name another: make install PYTHON=python3.12" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "'$(PYTHON) -m venv' failed; on Debian and Ubuntu install the package python3-venv" >&2; \
	  exit 1; }
	@echo "installing bayes_sensor and what its tests need into $(VENV) (a minute or two)"
	@$(PIP_INSTALL) -c $(CONSTRAINTS) -e '.[$(EXTRAS)]' || { \
	  $(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 14))' || exit 1; \
	  echo "no tested versions for this new Python; using the ranges in pyproject.toml" >&2; \
	  $(PIP_INSTALL) -e '.[$(EXTRAS)]'; }
	@echo "numerical functions are compiled when first used, a minute or two in all, and kept"
	@touch $@

demo: $(STAMP)
	$(ONE_THREAD) $(BIN)/bayes-sensor analyze data/reference/campaign.toml --out build/demo
	@echo "report: $(CURDIR)/build/demo/report.html"
	@echo "a campaign whose cause is withheld, diagnosed before its seal is opened:"
	$(ONE_THREAD) $(BIN)/bayes-sensor gap data/withheld/campaign.toml --out build/demo-withheld
	@$(BIN)/python data/open_seal.py build/demo-withheld

test: CHOSEN := not slow
test-slow: CHOSEN := slow
test test-slow: $(STAMP)
	@if $(BIN)/python -c 'import xdist' 2>/dev/null; then parallel="-n $(JOBS) --dist worksteal"; else parallel=; fi; \
	set -x; $(ONE_THREAD) $(BIN)/python -m pytest $$parallel -m "$(CHOSEN)" $(PYTEST_ARGS)

record: $(STAMP)
	PYTHONPATH=. $(ONE_THREAD) $(BIN)/python tests/record/make.py --check $(if $(CASES),--cases '$(CASES)')

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(STAMP) paper/studies/benchmark.py
	$(ONE_THREAD) $(BIN)/python paper/studies/benchmark.py
	$(ONE_THREAD) $(BIN)/python paper/studies/benchmark_commands.py $(if $(BEFORE),--before '$(BEFORE)')

study: $(STAMP) paper/studies/run_all.py
	$(ONE_THREAD) $(BIN)/python paper/studies/run_all.py --jobs $(JOBS)

coverage: $(STAMP) paper/studies/study_branches.py
	PYTHONPATH=. $(ONE_THREAD) $(BIN)/python paper/studies/study_branches.py

paper: $(STAMP) paper/build.py
	$(ONE_THREAD) $(BIN)/python paper/build.py

data: $(STAMP) data/make_reference.py
	$(ONE_THREAD) $(BIN)/python data/make_reference.py
	$(ONE_THREAD) $(BIN)/python data/make_withheld.py

docs: $(STAMP) docs/conf.py
	@$(PIP_INSTALL) -c $(CONSTRAINTS) -e '.[docs]'
	$(BIN)/python -m sphinx -W --keep-going -j $(JOBS) -b html docs build/docs
	@echo "pages: $(CURDIR)/build/docs/index.html"

screenshot: $(STAMP) docs/first_page.py
	PYTHONPATH=. $(ONE_THREAD) $(BIN)/python docs/first_page.py

# Builds need no environment of the project: a builder of their own, and the sources.
dist:
	@rm -rf dist build/builder
	@$(PYTHON) -m venv build/builder
	@build/builder/bin/python -m pip install --quiet --disable-pip-version-check build
	build/builder/bin/python -m build --sdist --wheel --outdir dist .

check-dist: dist
	build/builder/bin/python paper/studies/study_packaging.py dist $(if $(QUICK),--quick)

# What a target above runs and this checkout does not hold: say so, and fail.
paper/studies/benchmark.py paper/studies/run_all.py paper/build.py data/make_reference.py docs/conf.py:
	@echo "$@ is not in this checkout, so there is nothing to build from it" >&2; exit 1

clean:
	rm -rf build dist htmlcov .coverage .coverage.* .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find bayes_sensor tests data docs paper -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

clean-venv:
	rm -rf $(VENV)
