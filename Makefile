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
	.venv/bin/pytest -n 2 --dist loadgroup

# Missions with faults by chance on the virtual clock; the tables of the README, hours of missions; then links that
# misbehave and processes that are killed.
campaign: setup
	.venv/bin/python -m benchmarks.faults --missions 500
	.venv/bin/python -m benchmarks.faults --held
	.venv/bin/python -m benchmarks.disk
	.venv/bin/python -m benchmarks.campaign
	.venv/bin/python -m benchmarks.chaos --missions 50
	.venv/bin/python -m benchmarks.kills --kills 200

# Every stage at five million points, against alternatives; two idle cores tell the truth.
bench: setup
	.venv/bin/python -m benchmarks
