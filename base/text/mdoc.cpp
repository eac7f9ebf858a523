// SPDX-License-Identifier: Apache-2.0

#include <base/text/mdoc.hpp>

namespace agnocast::mdoc {

std::string plain(std::string_view text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\') {
      out += "\\e";
    } else {
      out += c;
    }
  }
  return out.starts_with('.') || out.starts_with('\'') ? "\\&" + out : out;
}

std::string lines_of(std::string_view text) {
  constexpr std::size_t columns = 78;
  std::string all, line;
  const auto end_line = [&] {
    if (!line.empty()) all += plain(line) + '\n';
    line.clear();
  };
  while (!text.empty()) {
    const std::size_t blank = text.find(' ');
    const std::string_view word = text.substr(0, blank);
    if (!line.empty() && line.size() + 1 + word.size() > columns) end_line();
    line += (line.empty() ? "" : " ") + std::string(word);
    if (word.ends_with('.')) end_line();
    text.remove_prefix(blank == std::string_view::npos ? text.size() : blank + 1);
  }
  end_line();
  return all;
}

std::string heading(std::string_view title, std::string_view section, std::string_view does,
                    std::string_view date) {
  std::string upper;
  for (const char c : title) upper += c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  std::string text = ".Dd ";
  text.append(date).append("\n.Dt ").append(upper).append(" ").append(section);
  text.append("\n.Os\n.Sh NAME\n.Nm ").append(title).append("\n.Nd ").append(does).append("\n");
  return text;
}

std::string flags_of(std::string_view names) {
  std::string flags;
  while (!names.empty()) {
    const std::size_t comma = names.find(',');
    std::string_view name = names.substr(0, comma);
    if (!flags.empty()) flags += " , ";
    flags += name.starts_with("--") ? "Fl Fl " : "Fl ";
    name.remove_prefix(name.starts_with("--") ? 2 : 1);
    flags += name;
    names.remove_prefix(comma == std::string_view::npos ? names.size() : comma + 1);
  }
  return flags;
}

}  // namespace agnocast::mdoc
