#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
#
# Goal: scripts/layers accepts this tree and refuses violations of its rules. Method: the real
# tree; then small trees with the real table, each with one violation.
import importlib.machinery
import importlib.util
import os
import sys
import tempfile
import unittest

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
sys.dont_write_bytecode = True
loader = importlib.machinery.SourceFileLoader("layers", os.path.join(ROOT, "scripts/layers"))
layers = importlib.util.module_from_spec(importlib.util.spec_from_loader("layers", loader))
loader.exec_module(layers)


class Layers(unittest.TestCase):
    def found(self, files, change=lambda text: text, check=layers.check):
        """Returns the problems of a tree of these files with the real ARCHITECTURE.md, changed by
        `change`."""
        with open(os.path.join(ROOT, "docs/ARCHITECTURE.md"), encoding="utf-8") as document:
            files = dict(files, **{"docs/ARCHITECTURE.md": change(document.read())})
        with tempfile.TemporaryDirectory() as tree:
            for path, text in files.items():
                os.makedirs(os.path.join(tree, os.path.dirname(path)), exist_ok=True)
                with open(os.path.join(tree, path), "w", encoding="utf-8") as file:
                    file.write(text)
            return check(tree)

    def test_this_tree(self):
        self.assertEqual(layers.check(ROOT), [])
        self.assertEqual(layers.check_for_use(ROOT), [])

    def test_includes(self):
        below = {
            "base/text/text.hpp": "",
            "dataplane/core.hpp": "",
            "client/session/context.hpp": "",
            "journal/x.hpp": "",
            "ros2/agnocast_rclcpp/include/agnocast_rclcpp/options.hpp": "",
            "ros2/agnocastlib/include/agnocastlib/core.hpp": "",
        }
        for path, line, allowed in [
            ("region/a.hpp", "#include <base/text/text.hpp>", True),
            ("base/a.hpp", "#include <region/a.hpp>", False),
            ("base/a.hpp", '#include "../journal/x.hpp"', False),
            ("journal/a.hpp", "#include <dataplane/core.hpp>", False),
            ("dataplane/a.hpp", "# include <journal/x.hpp>", False),
            ("daemon/state/a.cpp", "#include <dataplane/core.hpp>", False),
            ("ctl/cli/a.cpp", "#include <client/session/context.hpp>", False),
            ("client/endpoint/a.cpp", "#include <client/session/context.hpp>", False),
            ("client/executors/a.cpp", "#include <client/session/context.hpp>", True),
            ("client/session/a.cpp", '#include "context.hpp"', True),
            ("examples/a.cpp", "#include <base/text/text.hpp>", False),
            ("bench/a.cpp", "#include <base/text/text.hpp>", True),
            ("base/a.cpp", "#include <vector>", True),
            ("ros2/agnocastlib/src/a.cpp", "#include <agnocast_rclcpp/options.hpp>", True),
            ("ros2/agnocast_rclcpp/src/a.cpp", "#include <agnocastlib/core.hpp>", False),
            ("ros2/agnocast_rclcpp/src/a.cpp", "#include <agnocastlib/another.hpp>", False),
        ]:
            with self.subTest(path=path, line=line):
                problems = self.found(dict(below, **{"region/a.hpp": "", path: line + "\n"}))
                self.assertEqual([p.split(":")[0] for p in problems], [] if allowed else [path])

    def test_declarations(self):
        context = {
            "client/session/context.hpp": "class Context : public Base {\n};\n",
            "client/session/aligned.hpp": "struct alignas(64) Aligned {\n};\n",
        }
        for path, line, allowed in [
            ("client/endpoint/a.hpp", "class Context;", False),
            ("client/endpoint/a.hpp", "struct Elsewhere;", True),
            ("client/endpoint/a.hpp", "namespace agnocast { class Context; }", False),
            ("client/endpoint/a.hpp", "template <class T> class Context;", False),
            ("client/endpoint/a.hpp", "  friend class Context;", False),
            ("client/endpoint/a.hpp", "  class Context;", True),
            ("client/endpoint/a.hpp", "class Aligned;", False),
            ("client/session/a.hpp", "class Context;", True),
            ("client/executors/a.hpp", "class Context;", True),
            ("include/agnocast/a.hpp", "class Context;", True),
        ]:
            with self.subTest(path=path, line=line):
                problems = self.found(dict(context, **{path: line + "\n"}))
                self.assertEqual([p.split(":")[0] for p in problems], [] if allowed else [path])

    def test_a_folder_without_a_row(self):
        self.assertIn("no room", self.found({"daemon/other/a.cpp": ""})[0])
        self.assertIn("this one is not", self.found({"ctl/other/a.cpp": ""})[0])

    def test_a_row_that_points_upward(self):
        def upward(text):
            return text.replace(
                "| `views.hpp` | `base/`", "| `views.hpp` | `client/session/`, `base/`"
            )

        self.assertIn(
            "region/ may include client/session/, which is not a row above it",
            self.found({}, upward)[0],
        )

    def test_a_row_that_allows_more_than_is_used(self):
        problem = (
            "docs/ARCHITECTURE.md: no file of region/ includes one of base/, which its row allows"
        )
        self.assertIn(problem, self.found({}, check=layers.check_for_use))
        files = {"base/a.hpp": "", "region/a.hpp": "#include <base/a.hpp>\n"}
        self.assertNotIn(problem, self.found(files, check=layers.check_for_use))

    def test_another_picture(self):
        self.assertIn(
            "picture", self.found({}, lambda text: text.replace("  ctl --> journal\n", ""))[0]
        )


if __name__ == "__main__":
    unittest.main()
