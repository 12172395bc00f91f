# OpenClone: `make demo` and `make test` install what they need.

VENV := .venv
STAMP := $(VENV)/.installed
# `make install PYTHON=/path/to/python` chooses another interpreter (3.11 or 3.12).
PYTHON ?= $(shell python3.11 -c 'print("python3.11")' 2>/dev/null || echo python3)
TORCH := $(shell grep '^torch==' constraints.txt)
PURE_ROOMS := spatial robot motion policy evaluation
COVERAGE := $(foreach room,$(PURE_ROOMS),--cov=openclone.$(room))

.PHONY: install demo test lint format bench clean

install: $(STAMP)

# torch comes first and alone: a CPU build is enough, and the constraints keep it.
$(STAMP): pyproject.toml constraints.txt
	test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install $(TORCH)
	$(VENV)/bin/pip install -c constraints.txt -e '.[dev]'
	@sh scripts/offscreen.sh $(VENV)/bin/python
	touch $@

# VIEW=1 serves the browser page while the demo runs.
demo: install
	$(VENV)/bin/openclone demo $(if $(VIEW),--view)

# Two files at a time, which two cores just manage.
test: install
	$(VENV)/bin/pytest -n 2 --dist loadfile $(COVERAGE) --cov-report=term --cov-fail-under=85

lint: install
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/pyright

format: install
	$(VENV)/bin/ruff check --fix
	$(VENV)/bin/ruff format

# The others need a recording or more time: see their --help.
BENCHMARKS := training_rate policy_latency odometry_consistency odometry
bench: install
	for name in $(BENCHMARKS); do $(VENV)/bin/python benchmarks/$$name.py || exit 1; done

clean:
	rm -rf $(VENV) build .pytest_cache .ruff_cache .hypothesis .coverage
