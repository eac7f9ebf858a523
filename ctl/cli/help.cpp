// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/help.hpp>

#include <algorithm>
#include <vector>

namespace agnocast::ctl {
namespace {

constexpr std::size_t line_columns = 100;

/// Rows of two columns; the second column is wrapped.
class Rows {
 public:
  void add(std::string left, std::string_view right) {
    width_ = std::max(width_, left.size());
    rows_.push_back({std::move(left), std::string(right)});
  }
  std::string text() const {
    std::string all;
    for (const auto& [left, right] : rows_) {
      all += "  " + left + std::string(width_ - left.size() + 2, ' ');
      all += wrapped(right, width_ + 4) + '\n';
    }
    return all;
  }
  static std::string wrapped(std::string_view words, std::size_t indent) {
    std::string text;
    std::size_t column = indent;
    while (!words.empty()) {
      const std::size_t blank = words.find(' ');
      const std::string_view word = words.substr(0, blank);
      if (!text.empty() && column + 1 + word.size() > line_columns) {
        text += '\n' + std::string(indent, ' ');
        column = indent;
      } else if (!text.empty()) {
        text += ' ';
        ++column;
      }
      text += word;
      column += word.size();
      words.remove_prefix(blank == std::string_view::npos ? words.size() : blank + 1);
    }
    return text;
  }

 private:
  struct Row {
    std::string left, right;
  };
  std::vector<Row> rows_;
  std::size_t width_ = 0;
};

constexpr Option version{"--version", "print version and layout of shared memory"};
constexpr Option help{"-h,--help", "print this help; after a command, that of the command"};
constexpr const Option* common[] = {&options::socket, &options::json, &options::json_form, &version,
                                    &help};

std::string indented(std::string_view lines) {
  std::string text;
  while (!lines.empty()) {
    const std::size_t end = lines.find('\n');
    text += "  " + std::string(lines.substr(0, end)) + '\n';
    lines.remove_prefix(end == std::string_view::npos ? lines.size() : end + 1);
  }
  return text;
}

std::string options_text(std::span<const Option* const> options) {
  Rows rows;
  for (const Option* const option : options) rows.add(spelling_of(*option), meaning_of(*option));
  return rows.text();
}

}  // namespace

std::string spelling_of(const Option& option) {
  std::string text(option.names);
  if (const std::size_t comma = text.find(','); comma != std::string::npos)
    text.insert(comma + 1, " ");
  if (option.value.empty()) return text;
  return text + (option.value.starts_with('[') ? "" : " ") + std::string(option.value);
}

std::string meaning_of(const Option& option) {
  std::string text(option.meaning);
  for (std::string_view words = option.words; !words.empty();) {
    const std::size_t blank = words.find(' ');
    text += text.size() == option.meaning.size() ? ": " : ", ";
    text += words.substr(0, blank);
    words.remove_prefix(blank == std::string_view::npos ? words.size() : blank + 1);
  }
  if (!option.otherwise.empty()) text += "; default: " + std::string(option.otherwise);
  return text;
}

std::span<const Option* const> common_options() noexcept { return common; }

std::string help_of(std::span<const Command> commands, std::string_view noun) {
  Rows rows;
  std::string examples, plurals;
  for (const Command& command : commands) {
    if (command.verb == "list") plurals += (plurals.empty() ? "" : ", ") + plural_of(command.noun);
    if (!noun.empty() && command.noun != noun) continue;
    rows.add(usage_of(command), command.summary);
    examples += indented(command.examples.substr(0, command.examples.find('\n')));
  }
  return "Inspects agnocast: topics, nodes, processes, messages, shared heaps. A command "
         "changes nothing\nand subscribes to nothing unless its description says so.\n\n"
         "Usage: agnocast-ctl NOUN [VERB] [NAME] [OPTION...]\n\n" +
         rows.text() + "\nPlural nouns are short for list: " + plurals + ".\n\nCommon options:\n" +
         options_text(common) + "\nExamples:\n" + examples +
         "\nExit status: 0 done, 1 failed, 2 wrong usage, 3 daemon not reachable, 4 no such topic, "
         "node\nor process, 5 permission denied, 6 a check of doctor or verify failed, 124 timed "
         "out.\n";
}

std::string help_of(const Command& command) {
  std::string text = std::string(command.summary) + "\n\nUsage: agnocast-ctl " + usage_of(command) +
                     " [OPTION...]\n\n";
  if (!command.description.empty()) text += Rows::wrapped(command.description, 0) + "\n\n";
  if (!command.subjects.empty()) {
    Rows rows;
    for (const Subject* const subject : command.subjects)
      rows.add(std::string(subject->name), subject->meaning);
    text += rows.text() + '\n';
  }
  if (!command.options.empty()) text += "Options:\n" + options_text(command.options) + '\n';
  text += "Common options:\n" + options_text(common);
  return text + "\nExamples:\n" + indented(command.examples);
}

}  // namespace agnocast::ctl
