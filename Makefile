.PHONY: setup mission test lint campaign bench

export OMP_NUM_THREADS ?= 2

setup:
	@bash .ci/setup

# A simulated robot scans the paper's six-room school, to its report.
mission: setup
	.venv/bin/mission simulate school

lint: setup
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/lint-imports

test: lint
	.venv/bin/pytest -n 2

# The tables of the README: hours of missions; before them, those on the virtual clock with faults by chance.
campaign: setup
	.venv/bin/python -m benchmarks.faults --missions 500
	.venv/bin/python -m benchmarks.faults --held
	.venv/bin/python -m benchmarks.disk
	.venv/bin/python -m benchmarks.campaign

# Every stage at five million points, against alternatives; two idle cores tell the truth.
bench: setup
	.venv/bin/python -m benchmarks
