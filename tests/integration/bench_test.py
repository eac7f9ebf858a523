#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
#
# Goal: a case of agnocast-bench works, and its results and pictures follow their schema. Method:
# the shortest run, its JSON checked against the schema, every picture present, its temporary
# directory empty afterwards. Its measurements mean nothing, so the test asserts no time.
#
#   bench_test.py AGNOCAST_BENCH CASE SCHEMA MINIMUM_OF_RESULTS
import importlib.util
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import jsonschema

program, case, schema, minimum = sys.argv[1:5]
# Numbers that describe the measurement, not its result.
labels = {"cores", "size_bytes", "receivers", "rounds", "period_ns", "samples", "bound"}


def has_figure(result):
    return any(type(value) in (int, float) for key, value in result.items() if key not in labels)


with tempfile.TemporaryDirectory() as name:
    directory = pathlib.Path(name)
    directory.chmod(0o755)  # for what goes across users
    results = directory / "results.json"
    command = [program, case, "--small", "--json", str(results)]
    has_matplotlib = (
        importlib.util.find_spec("matplotlib") is not None
    )  # the plotter is run by the same Python
    if has_matplotlib:
        command += ["--plot", str(directory / "plots")]
    temporary = directory / "temporary"
    temporary.mkdir()
    subprocess.run(command, check=True, env={**os.environ, "TMPDIR": str(temporary)})
    document = json.loads(results.read_text())
    rules = json.loads(pathlib.Path(schema).read_text())
    jsonschema.Draft7Validator.check_schema(rules)
    errors = [
        f"/{'/'.join(map(str, error.absolute_path))}: {error.message[:300]}"
        for error in jsonschema.Draft7Validator(rules).iter_errors(document)
    ]
    errors += [f"left behind: {path.name}" for path in temporary.iterdir()]
    # A long run goes on without a peer that fails; here such a failure must be visible.
    errors += [why for why in document["environment"]["left_out"] if "has failed" in why]
    count = sum(map(has_figure, document["results"]))
    if count < int(minimum):
        errors.append(f"{count} results with figures, at least {minimum} are wanted")
    errors += [
        f"a result of another case: {result['case']}"
        for result in document["results"]
        if result["case"] != case
    ]
    if has_matplotlib:
        if not document["plots"]:
            errors.append("there are no plots")
        for plot in document["plots"]:
            for suffix in ("svg", "png"):
                picture = directory / "plots" / f"{plot['name']}.{suffix}"
                if not picture.is_file() or picture.stat().st_size < 1000:
                    errors.append(f"no picture {picture.name}")
    print("\n".join(errors))
    sys.exit(1 if errors else 0)
