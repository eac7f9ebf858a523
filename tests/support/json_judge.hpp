// SPDX-License-Identifier: Apache-2.0
//
// judge_json: collects all JSON that agnocast-ctl printed, and validates it against the installed
// schemas when the test program ends. So every test of an output also tests its schema.
#pragma once

#include <string>

namespace agnocast::test {

/// `text`: one object, or one per line.
void judge_json(const std::string& text);

}  // namespace agnocast::test
