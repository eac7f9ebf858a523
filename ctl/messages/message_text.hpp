// SPDX-License-Identifier: Apache-2.0
//
// Messages as text: YAML in the shape of `ros2 topic echo`, the same on one line, CSV, and JSON.
//
// YAML and JSON lose nothing (message_read.hpp reads the YAML back): numbers have as many digits as
// it takes, and text that is no UTF-8 is YAML's !!binary, or {"base64": "…"} in JSON. What is printed
// is fit for a terminal: control characters, line separators and marks that turn the direction of
// writing are escaped.
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
  bool no_arrays = false;                    // their type and length instead
  bool no_strings = false;                   // their length instead
};

/// Lines, the last one ended; of a scalar or an array by itself as well.
std::string yaml_of(const Value& value, const TextOptions& options);
/// In braces, on one line, without its end.
std::string flow_yaml_of(const Value& value, const TextOptions& options);
/// A scalar without quotes if it can be shown so; else as YAML.
std::string bare_text_of(const Value& scalar, const TextOptions& options);
/// All scalars in order, between commas. A text with a comma, a quote or something that needs
/// escaping is in quotes; quotes in it are doubled.
std::string csv_of(const Value& value, const TextOptions& options);
/// NaN and infinities are "NaN", "Infinity" and "-Infinity".
Object json_of(const Value& value, const TextOptions& options);
/// Two hexadecimal digits a byte, 32 bytes a line.
std::string hexadecimal_bytes(const void* first, std::size_t bytes, const TextOptions& options);

/// YAML's and Python's: "1.0e+16", "0.1", ".nan", "-.inf".
std::string yaml_number(double number);

}  // namespace agnocast::ctl
