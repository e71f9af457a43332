# Two commands: `make run` drives laps, `make test` runs the tests. Both set up .venv first.
PYTHON ?= python3
# which build of PyTorch: cpu, auto (as the GPU at hand needs), or one by name, cu130, rocm6.4, ...
TORCH ?= cpu
VENV := .venv
INSTALLED := $(VENV)/.installed
CARRACING := $(VENV)/bin/carracing

.PHONY: setup run train test test-all faults docs lint clean

setup: $(INSTALLED)

$(INSTALLED): setup.py setup.cfg package.xml constraints.txt .ci/setup carracing_dqn/bringup/environment.py
	@bash .ci/setup '$(PYTHON)' '$(VENV)' '$(TORCH)'
	@touch $@

run: setup
	$(CARRACING) run $(ARGS)

train: setup
	$(CARRACING) train $(ARGS)

test: setup
	$(VENV)/bin/python -m pytest $(ARGS)

# setup, a drive and the tests with every Python that README names, each in a new environment
test-all:
	@bash .ci/test-all $(ARGS)

# every kind of fault for MINUTES; what came of it is written below runs/, see docs/reliability.md
faults: MINUTES = 60
faults: SEED = 1
faults: setup
	PYTHONPATH=tests $(VENV)/bin/python -m faults --minutes $(MINUTES) --seed $(SEED) $(ARGS)

# the pages as a site, below build/docs; every warning is an error
docs: setup
	@$(VENV)/bin/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	@$(VENV)/bin/python -m sphinx -W --keep-going -q -c docs . build/docs
	@echo build/docs/index.html

lint: setup
	$(VENV)/bin/ruff check .

clean:
	rm -rf $(VENV) build install log *.egg-info
