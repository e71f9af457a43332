# Two commands: `make run` drives laps, `make test` runs the tests. Both set up .venv first.
PYTHON ?= python3
VENV := .venv
INSTALLED := $(VENV)/.installed
CARRACING := $(VENV)/bin/carracing

.PHONY: setup run train test faults lint clean

setup: $(INSTALLED)

$(INSTALLED): setup.py setup.cfg constraints.txt carracing_dqn/bringup/environment.py
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --use-pep517 --constraint constraints.txt --editable '.[wheels,test]'
	$(VENV)/bin/python -m carracing_dqn.bringup.environment
	touch $@

run: setup
	$(CARRACING) run $(ARGS)

train: setup
	$(CARRACING) train $(ARGS)

test: setup
	$(VENV)/bin/python -m pytest $(ARGS)

# every kind of fault for MINUTES; what came of it is written below runs/, see docs/reliability.md
faults: MINUTES = 60
faults: SEED = 1
faults: setup
	PYTHONPATH=tests $(VENV)/bin/python -m faults --minutes $(MINUTES) --seed $(SEED) $(ARGS)

lint: setup
	$(VENV)/bin/ruff check .

clean:
	rm -rf $(VENV) build install log *.egg-info
