#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compiles a source in which each REFUSED(name, "sentence", body) has to be refused with its
sentence.

  refused_test.py SOURCE SENTENCE COMPILER…

SENTENCE is that of the source as a whole; - if each case has its own. Without -DREFUSED_… among the
compiler's arguments the source has to compile without a word. Exit status 0: everything is as it
has to be."""

import re
import subprocess
import sys


def cases_of(source):
    """Returns name, sentence, first and last line of each case."""
    text = source.read()
    for case in re.finditer(r'^REFUSED\(\s*(\w+),\s*((?:"[^"\n]*"\s*)+),', text, re.MULTILINE):
        sentence = "".join(re.findall(r'"([^"\n]*)"', case[2]))
        first = text.count("\n", 0, case.start()) + 1
        end = re.compile(r";\)$", re.MULTILINE).search(text, case.end())
        yield case[1], sentence, first, text.count("\n", 0, end.end()) + 1


def errors_by_line(errors, source):
    """Returns the errors that each line of the source causes, by itself or as what a template is
    needed for."""
    causes, found = None, {}
    place = re.compile(re.escape(source) + r":(\d+):\d+: +(required from here|error: )")
    for line in errors.splitlines():
        if here := place.match(line):
            causes = int(here[1])
        if ": error: " in line:
            found.setdefault(causes, []).append(line)
    return found


def main():
    source, common, command = sys.argv[1], sys.argv[2], sys.argv[3:]
    compiled = subprocess.run(
        [*command, source],
        capture_output=True,
        text=True,
        check=False,
        env={"LC_ALL": "C", "PATH": "/usr/bin:/bin"},
    )
    if not any(word.startswith("-DREFUSED_") for word in command):
        print(compiled.stderr)
        return 0 if compiled.returncode == 0 and not compiled.stderr else 1
    if common != "-":
        print(compiled.stderr)
        return 0 if re.search("error: .*agnocast: .*" + re.escape(common), compiled.stderr) else 1
    errors = errors_by_line(compiled.stderr, source)
    active = subprocess.run(
        [*command, "-E", "-fdirectives-only", source], capture_output=True, text=True, check=False
    ).stdout
    wrong = count = 0
    with open(source, encoding="utf-8") as text:
        cases = list(cases_of(text))
    for name, sentence, first, last in cases:
        if not re.search(rf"^REFUSED\(\s*{name},", active, re.MULTILINE):
            continue
        count += 1
        wanted = re.compile("error: .*agnocast: .*" + re.escape(sentence))
        of_case = [error for line in range(first, last + 1) for error in errors.get(line, [])]
        is_refused = any(wanted.search(error) for error in of_case)
        print("refused" if is_refused else "NOT refused", name, "by:", sentence)
        if not is_refused:
            print("\n".join(of_case) or "no error")
            wrong += 1
    listed = len(re.findall(r"^REFUSED\(", active, re.MULTILINE))
    if count != listed:
        print(f"{listed} cases, and {count} were read")
    if wrong or not count or count != listed:
        print(compiled.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
