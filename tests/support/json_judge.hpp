// SPDX-License-Identifier: Apache-2.0
//
// judge_json: keeps all JSON that a test program made agnocast-ctl print, and holds it to the
// installed schemas when the program ends. So every test of an output is one of its schema too.
#pragma once

#include <string>

namespace agnocast::test {

/// `text`: one object, or one on each line.
void judge_json(const std::string& text);

}  // namespace agnocast::test
