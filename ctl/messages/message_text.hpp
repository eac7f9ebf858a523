// SPDX-License-Identifier: Apache-2.0
//
// Messages as text: YAML in the form of `ros2 topic echo`, the same on one line, CSV, and JSON.
//
// YAML and JSON are lossless (message_read.hpp reads the YAML back): numbers have all necessary
// digits, and text that is not UTF-8 becomes !!binary in YAML or {"base64": "…"} in JSON. The
// output is safe for a terminal: control characters, line separators and marks that change the
// direction of writing are escaped.
#pragma once

#include <ctl/cli/console.hpp>
#include <ctl/messages/message_value.hpp>

#include <cstddef>
#include <limits>
#include <string>
#include <string_view>

namespace agnocast::ctl {

struct TextOptions {
  static constexpr std::size_t everything = std::numeric_limits<std::size_t>::max();
  std::size_t truncate_length = everything;  // elements of an array, characters of a string
  bool no_arrays = false;                    // prints their type and length instead
  bool no_strings = false;                   // prints their length instead
};

/// Returns lines, each with its newline; also for a single scalar or array.
std::string yaml_of(const Value& value, const TextOptions& options);
/// Returns one line in braces, without a newline.
std::string flow_yaml_of(const Value& value, const TextOptions& options);
/// Returns a scalar without quotes if possible, else as YAML.
std::string bare_text_of(const Value& scalar, const TextOptions& options);
/// Returns all scalars in order, separated by commas. A text with a comma, a quote or a character
/// that needs escaping is quoted; quotes in it are doubled.
std::string csv_of(const Value& value, const TextOptions& options);
/// Returns JSON; NaN and infinities are "NaN", "Infinity" and "-Infinity".
Object json_of(const Value& value, const TextOptions& options);
/// Returns two hexadecimal digits a byte, 32 bytes a line.
std::string hexadecimal_bytes(const void* first, std::size_t bytes, const TextOptions& options);

/// Returns a number valid in YAML and Python: "1.0e+16", "0.1", ".nan", "-.inf".
std::string yaml_number(double number);

}  // namespace agnocast::ctl
