#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
#
# Goal: scripts can rely on agnocast-bench: its exit status tells success from failure, it reports
# wrong usage before anything runs, and with --json=- its standard output is exactly one JSON
# document. Method: its command lines, with the shortest runs.
#
#   bench_command_test.py AGNOCAST_BENCH SCHEMA
import json
import os
import pathlib
import subprocess
import sys

import jsonschema

program, schema = sys.argv[1:3]
rules = jsonschema.Draft7Validator(json.loads(pathlib.Path(schema).read_text()))
errors = []


def run(*arguments, status, environment=None):
    variables = {**os.environ, **(environment or {})}
    ran = subprocess.run(
        [program, *arguments], capture_output=True, text=True, timeout=200, env=variables
    )
    if ran.returncode != status:
        errors.append(f"{' '.join(arguments)}: status {ran.returncode}, not {status}: {ran.stderr}")
    return ran


def document_of(ran):
    """All of standard output, which json.loads wants to be one document."""
    try:
        document = json.loads(ran.stdout)
    except ValueError as error:
        errors.append(
            f"{' '.join(ran.args[1:])}: standard output is no JSON document: {error}: "
            f"{ran.stdout[:300]}"
        )
        return {}
    errors.extend(
        f"{' '.join(ran.args[1:])}: {error.message[:300]}" for error in rules.iter_errors(document)
    )
    return document


# --- options that only print
for option, wanted in (("--help", "--rounds"), ("--list", "latency")):
    ran = run(option, status=0)
    if wanted not in ran.stdout or ran.stderr:
        errors.append(f"{option}: {ran.stdout}{ran.stderr}")

# --- wrong usage: the problem and a hint, before anything is measured
for arguments, wanted in (
    ([], "which case"),
    (["laziness"], "there is no case 'laziness'"),
    (["alloc", "--rounds", "0"], "--rounds"),
    (["alloc", "--period", "1ms"], "alloc does not take --period"),
    (["memory", "--systems", "agnocast-executor"], "memory does not take --systems"),
    (
        ["throughput", "--systems", "floor-eventfd"],
        "throughput does not take --systems floor-eventfd",
    ),
    (["death", "--sizes", "1K,1M"], "death does not take more than one of --sizes"),
    (["throughput", "--sizes", "100"], "throughput has messages of 64 B and 1 MiB only"),
    (["pipeline", "--rounds", "2"], "pipeline does not take --rounds"),
):
    ran = run(*arguments, status=2)
    if wanted not in ran.stderr or "hint:" not in ran.stderr or ran.stdout:
        errors.append(f"{arguments}: {ran.stdout}{ran.stderr}")

# --- runs that fail
ran = run("alloc", "--small", "--json", "/nowhere/at/all.json", status=1)
if "/nowhere/at/all.json" not in ran.stderr or "==" in ran.stdout:
    errors.append(f"a file that cannot be written: {ran.stdout}{ran.stderr}")
ran = run("memory", "--small", "--json", "-", status=1, environment={"TMPDIR": "/nowhere"})
document = document_of(ran)
if "memory" not in document.get("failed", {}) or "/nowhere" not in ran.stderr:
    errors.append(f"a case that fails: {document.get('failed')}, {ran.stderr}")

# --- a case whose processes are those of a package that is not there
ran = run("ros2", "--small", "--json", "-", status=0, environment={"AMENT_PREFIX_PATH": "/nowhere"})
document = document_of(ran)
left_out = " ".join(document.get("environment", {}).get("left_out", []))
if document.get("results") != [] or "build the package agnocast_rclcpp" not in left_out:
    errors.append(f"a case without its processes: {document.get('results')}, {left_out}")

# --- standard output, with processes of all kinds
ran = run("latency", "alloc", "--small", "--rounds", "1", "--json", "-", status=0)
document = document_of(ran)
if {result["case"] for result in document.get("results", [])} != {
    "latency",
    "alloc",
} or "failed" in document:
    errors.append(f"results: {document.get('failed')}")

print("\n".join(errors))
sys.exit(1 if errors else 0)
