// SPDX-License-Identifier: Apache-2.0

#include <base/text/text.hpp>
#include <ctl/cli/unicode.hpp>
#include <ctl/messages/message_text.hpp>

#include <yaml-cpp/binary.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>

namespace agnocast::ctl {
namespace {

using std::string_view_literals::operator""sv;

// Formats a number as Python's repr() does: the fewest digits that restore it, and an exponent
// only below 1e-4 and from 1e16 upwards.
std::string python_digits(double number) {
  char text[64];
  const auto end = std::to_chars(text, text + sizeof text, number, std::chars_format::scientific);
  const std::string_view all(text, static_cast<std::size_t>(end.ptr - text));
  const std::size_t mark = all.find('e');
  int exponent = 0;
  std::from_chars(all.data() + mark + (all[mark + 1] == '+' ? 2 : 1), end.ptr, exponent);
  if (exponent < -4 || exponent >= 16) return std::string(all);
  std::string plain(text,
                    std::to_chars(text, text + sizeof text, number, std::chars_format::fixed).ptr);
  return plain.find('.') == plain.npos ? plain + ".0" : plain;
}

// --- text

std::string to_base64(std::string_view bytes) {
  return YAML::EncodeBase64(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
}

/// A text as Unicode; in base64 if it is not valid Unicode.
struct Text {
  std::optional<std::u32string> letters;
  std::string base64;
  std::size_t unit_count = 0;  // bytes of a string, words of a wide one
};
Text text_of(const Scalar& scalar) {
  Text text;
  if (const auto* const narrow = std::get_if<std::string_view>(&scalar)) {
    text.letters = from_utf8(*narrow);
    text.unit_count = narrow->size();
    if (!text.letters) text.base64 = to_base64(*narrow);
  } else {
    const std::u16string_view wide = std::get<std::u16string_view>(scalar);
    text.letters = from_utf16(wide);
    text.unit_count = wide.size();
    if (!text.letters) text.base64 = to_base64(utf16_bytes(wide));
  }
  return text;
}

void truncate(Text& text, const TextOptions& options) {
  if (text.letters && text.letters->size() > options.truncate_length) {
    text.letters->resize(options.truncate_length);
    *text.letters += U"...";
  }
}

std::string length_of(const Text& text) {
  return "<string length: <" +
         std::to_string(text.letters ? text.letters->size() : text.unit_count) + ">>";
}

bool is_blank(char32_t letter) { return letter == U' '; }

std::string double_quoted(std::u32string_view letters) {
  std::string text = "\"";
  for (const char32_t letter : letters) {
    char escape[16];
    switch (letter) {
      case U'\0':
        text += "\\0";
        continue;
      case U'\a':
        text += "\\a";
        continue;
      case U'\b':
        text += "\\b";
        continue;
      case U'\t':
        text += "\\t";
        continue;
      case U'\n':
        text += "\\n";
        continue;
      case U'\v':
        text += "\\v";
        continue;
      case U'\f':
        text += "\\f";
        continue;
      case U'\r':
        text += "\\r";
        continue;
      case U'\x1b':
        text += "\\e";
        continue;
      case U'"':
        text += "\\\"";
        continue;
      case U'\\':
        text += "\\\\";
        continue;
      default:
        break;
    }
    if (is_printable(letter)) {
      append_utf8(text, letter);
      continue;
    }
    const auto number = static_cast<unsigned>(letter);
    if (letter < 0x100) {
      std::snprintf(escape, sizeof escape, "\\x%02x", number);
    } else if (letter < 0x10000) {
      std::snprintf(escape, sizeof escape, "\\u%04x", number);
    } else {
      std::snprintf(escape, sizeof escape, "\\U%08x", number);
    }
    text += escape;
  }
  return text + '"';
}

// Returns whether a YAML 1.1 or 1.2 parser takes the plain text for something other than text.
bool is_taken_for_another(std::string_view text) {
  static constexpr std::string_view words[] = {
      "~",    "null", "Null", "NULL", "true",  "True",  "TRUE",  "false", "False", "FALSE",
      "yes",  "Yes",  "YES",  "no",   "No",    "NO",    "on",    "On",    "ON",    "off",
      "Off",  "OFF",  "y",    "Y",    "n",     "N",     "=",     "<<",    ".nan",  ".NaN",
      ".NAN", ".inf", ".Inf", ".INF", "+.inf", "-.inf", "+.Inf", "-.Inf", "+.INF", "-.INF"};
  if (std::find(std::begin(words), std::end(words), text) != std::end(words)) return true;
  // Numbers, dates and times of day, in any of their forms.
  return std::string_view("0123456789+-.").find(text.front()) != text.npos &&
         text.find_first_not_of("0123456789abcdefABCDEFxXoO_.:+-tTzZ ") == text.npos;
}

bool can_be_plain(std::u32string_view letters, bool in_flow) {
  if (letters.empty() || is_blank(letters.front()) || is_blank(letters.back())) return false;
  constexpr std::u32string_view indicators = U"#,[]{}&*!|>'\"%@`";
  if (indicators.find(letters.front()) != letters.npos) return false;
  if (letters.starts_with(U"---") || letters.starts_with(U"...")) return false;
  for (std::size_t i = 0; i < letters.size(); ++i) {
    const bool ends = i + 1 == letters.size() || is_blank(letters[i + 1]);
    if (letters[i] == U':' && (ends || in_flow)) return false;
    if (i == 0 && (letters[i] == U'-' || letters[i] == U'?') && (ends || in_flow)) return false;
    if (letters[i] == U'#' && is_blank(letters[i - 1])) return false;
    if (in_flow && U",?[]{}"sv.find(letters[i]) != std::u32string_view::npos) return false;
  }
  return true;
}

std::string yaml_text(std::u32string_view letters, bool in_flow) {
  if (!std::all_of(letters.begin(), letters.end(), is_printable)) return double_quoted(letters);
  std::string text;
  for (const char32_t letter : letters) append_utf8(text, letter);
  if (can_be_plain(letters, in_flow) && !is_taken_for_another(text)) return text;
  std::string quoted = "'";
  for (const char letter : text) quoted += letter == '\'' ? "''" : std::string(1, letter);
  return quoted + '\'';
}
std::string yaml_ascii(std::string_view ascii, bool in_flow) {
  return yaml_text(std::u32string(ascii.begin(), ascii.end()), in_flow);
}

std::string yaml_scalar(const Value& value, const TextOptions& options, bool in_flow) {
  const Scalar scalar = value.scalar();
  if (const auto* const boolean = std::get_if<bool>(&scalar)) return *boolean ? "true" : "false";
  if (const auto* const number = std::get_if<std::int64_t>(&scalar)) return std::to_string(*number);
  if (const auto* const number = std::get_if<std::uint64_t>(&scalar))
    return std::to_string(*number);
  if (const auto* const number = std::get_if<double>(&scalar)) return yaml_number(*number);
  Text text = text_of(scalar);
  if (options.no_strings) return yaml_ascii(length_of(text), in_flow);
  if (!text.letters) return "!!binary \"" + text.base64 + '"';
  truncate(text, options);
  return yaml_text(*text.letters, in_flow);
}

// --- arrays

/// Returns the summary that ros2 prints instead of an array's elements, with IDL type names.
std::string summary_of(const Value& array) {
  const Shape& shape = array.shape();
  std::string type = shape.element().type_name();
  type = type.substr(0, type.find("<="));
  for (const auto& [ours, theirs] :
       {std::pair("bool", "boolean"), std::pair("byte", "octet"), std::pair("float32", "float"),
        std::pair("float64", "double")}) {
    if (type == ours) type = theirs;
  }
  const std::string bound = "[" + std::to_string(shape.member->array_size_) + "]";
  if (shape.is_fixed()) return "<array type: " + type + bound + ">";
  return "<sequence type: " + type + (shape.member->is_upper_bound_ ? bound : "") +
         ", length: " + std::to_string(array.size()) + ">";
}

/// The number of elements to print, and whether others are left out.
struct Shown {
  std::size_t count;
  bool is_truncated;
};
Shown shown_of(const Value& array, const TextOptions& options) {
  const std::size_t size = array.size();
  return {std::min(size, options.truncate_length), size > options.truncate_length};
}

// --- block style

class Block {
 public:
  explicit Block(const TextOptions& options) : options_(options) {}

  void message(const Value& value, std::size_t indent, bool is_continued) {
    for (std::uint32_t i = 0; i < value.shape().field_count(); ++i) {
      if (i != 0 || !is_continued) text_.append(indent, ' ');
      text_ += value.shape().field_name(i);
      text_ += ':';
      const Value field = value.field(i);
      if (is_inline(field)) {
        text_ += ' ';
        text_ += one_line(field);
        text_ += '\n';
      } else {
        text_ += '\n';
        if (field.shape().is_array) {
          array(field, indent);
        } else {
          message(field, indent + 2, false);
        }
      }
    }
  }
  void array(const Value& value, std::size_t indent) {
    const Shown shown = shown_of(value, options_);
    for (std::size_t i = 0; i < shown.count; ++i) {
      const Value element = value.element(i);
      text_.append(indent, ' ');
      text_ += "- ";
      if (is_inline(element)) {
        text_ += one_line(element);
        text_ += '\n';
      } else {
        message(element, indent + 2, true);
      }
    }
    if (shown.is_truncated) {
      text_.append(indent, ' ');
      text_ += "- '...'\n";
    }
  }
  bool is_inline(const Value& value) const {
    if (value.shape().is_message()) return value.shape().field_count() == 0;
    return !value.shape().is_array || options_.no_arrays || value.size() == 0;
  }
  std::string one_line(const Value& value) const {
    if (value.shape().is_message()) return "{}";
    if (!value.shape().is_array) return yaml_scalar(value, options_, false);
    return options_.no_arrays ? yaml_ascii(summary_of(value), false) : "[]";
  }
  std::string take() { return std::move(text_); }

 private:
  const TextOptions& options_;
  std::string text_;
};

void append_flow(std::string& text, const Value& value, const TextOptions& options) {
  if (value.shape().is_scalar()) {
    text += yaml_scalar(value, options, true);
  } else if (value.shape().is_message()) {
    text += '{';
    for (std::uint32_t i = 0; i < value.shape().field_count(); ++i) {
      text += (i == 0 ? "" : ", ") + std::string(value.shape().field_name(i)) + ": ";
      append_flow(text, value.field(i), options);
    }
    text += '}';
  } else if (options.no_arrays) {
    text += yaml_ascii(summary_of(value), true);
  } else {
    const Shown shown = shown_of(value, options);
    text += '[';
    for (std::size_t i = 0; i < shown.count; ++i) {
      if (i != 0) text += ", ";
      append_flow(text, value.element(i), options);
    }
    text += shown.is_truncated ? (shown.count == 0 ? "'...']" : ", '...']") : "]";
  }
}

void append_csv(std::string& text, bool& is_first, const Value& value, const TextOptions& options) {
  const auto add = [&](std::string_view cell) {
    if (!is_first) text += ',';
    is_first = false;
    text += cell;
  };
  if (value.shape().is_message()) {
    for (std::uint32_t i = 0; i < value.shape().field_count(); ++i)
      append_csv(text, is_first, value.field(i), options);
  } else if (value.shape().is_array) {
    if (options.no_arrays) return add(summary_of(value));
    const Shown shown = shown_of(value, options);
    for (std::size_t i = 0; i < shown.count; ++i)
      append_csv(text, is_first, value.element(i), options);
    if (shown.is_truncated) add("...");
  } else {
    const Scalar scalar = value.scalar();
    if (const auto* const boolean = std::get_if<bool>(&scalar))
      return add(*boolean ? "True" : "False");  // Python's form, as in ros2
    if (const auto* const number = std::get_if<double>(&scalar)) {
      if (std::isnan(*number)) return add("nan");
      if (std::isinf(*number)) return add(*number > 0 ? "inf" : "-inf");
      return add(python_digits(*number));
    }
    const std::string bare = bare_text_of(value, options);
    if (bare.find_first_of(",\"") == bare.npos) return add(bare);
    std::string quoted = "\"";
    for (const char letter : bare) quoted += letter == '"' ? "\"\"" : std::string(1, letter);
    add(quoted + '"');
  }
}

}  // namespace

std::string yaml_number(double number) {
  if (std::isnan(number)) return ".nan";
  if (std::isinf(number)) return number > 0 ? ".inf" : "-.inf";
  std::string text = python_digits(number);
  // Without a decimal point YAML 1.1 does not take it for a number.
  const std::size_t mark = text.find('e');
  if (mark != text.npos && text.find('.') == text.npos) text.insert(mark, ".0");
  return text;
}

std::string yaml_of(const Value& value, const TextOptions& options) {
  Block block(options);
  if (block.is_inline(value)) return block.one_line(value) + '\n';
  if (value.shape().is_array) {
    block.array(value, 0);
  } else {
    block.message(value, 0, false);
  }
  return block.take();
}

std::string flow_yaml_of(const Value& value, const TextOptions& options) {
  std::string text;
  append_flow(text, value, options);
  return text;
}

std::string bare_text_of(const Value& value, const TextOptions& options) {
  if (!value.shape().is_text()) return yaml_scalar(value, options, false);
  Text text = text_of(value.scalar());
  if (options.no_strings) return length_of(text);
  if (!text.letters) return "!!binary " + text.base64;
  truncate(text, options);
  if (!std::all_of(text.letters->begin(), text.letters->end(), is_printable))
    return double_quoted(*text.letters);
  std::string bare;
  for (const char32_t letter : *text.letters) append_utf8(bare, letter);
  return bare;
}

std::string csv_of(const Value& value, const TextOptions& options) {
  std::string text;
  bool is_first = true;
  append_csv(text, is_first, value, options);
  return text;
}

Object json_of(const Value& value, const TextOptions& options) {
  if (value.shape().is_message()) {
    Object object = Object::object();
    for (std::uint32_t i = 0; i < value.shape().field_count(); ++i)
      object[std::string(value.shape().field_name(i))] = json_of(value.field(i), options);
    return object;
  }
  if (value.shape().is_array) {
    if (options.no_arrays) return summary_of(value);
    Object list = Object::array();
    const Shown shown = shown_of(value, options);
    for (std::size_t i = 0; i < shown.count; ++i)
      list.push_back(json_of(value.element(i), options));
    if (shown.is_truncated) list.push_back("...");
    return list;
  }
  const Scalar scalar = value.scalar();
  if (const auto* const boolean = std::get_if<bool>(&scalar)) return *boolean;
  if (const auto* const number = std::get_if<std::int64_t>(&scalar)) return *number;
  if (const auto* const number = std::get_if<std::uint64_t>(&scalar)) return *number;
  if (const auto* const number = std::get_if<double>(&scalar)) {
    if (std::isnan(*number)) return "NaN";
    if (std::isinf(*number)) return *number > 0 ? "Infinity" : "-Infinity";
    return *number;
  }
  Text text = text_of(scalar);
  if (options.no_strings) return length_of(text);
  if (!text.letters) return {{"base64", text.base64}};
  truncate(text, options);
  std::string utf8;
  for (const char32_t letter : *text.letters) append_utf8(utf8, letter);
  return utf8;
}

std::string hexadecimal_bytes(const void* first, std::size_t bytes, const TextOptions& options) {
  constexpr std::size_t bytes_per_line = 32;
  const std::size_t count = std::min(bytes, options.truncate_length);
  std::string text;
  for (std::size_t i = 0; i < count; ++i) {
    char digits[4];
    std::snprintf(digits, sizeof digits, "%02x",
                  static_cast<unsigned>(static_cast<const std::uint8_t*>(first)[i]));
    text += digits;
    if ((i + 1) % bytes_per_line == 0 || i + 1 == count) text += '\n';
  }
  return count < bytes ? text + "...\n" : text;
}

}  // namespace agnocast::ctl
