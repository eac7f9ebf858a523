// SPDX-License-Identifier: Apache-2.0

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/version.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/help.hpp>

#include <CLI/CLI.hpp>

#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

namespace agnocast::ctl {
namespace {

constexpr const char* program = "agnocast-ctl";
constexpr const char* help_command = "agnocast-ctl --help";

std::string version_text() {
  char text[96];
  std::snprintf(text, sizeof text, "agnocast-ctl %d.%d.%d (layout %016llx)\n",
                AGNOCAST_VERSION_MAJOR, AGNOCAST_VERSION_MINOR, AGNOCAST_VERSION_PATCH,
                static_cast<unsigned long long>(abi::fingerprint()));
  return text;
}

tl::unexpected<Problem> wrong_usage(std::string what, std::string why,
                                    std::string hint = help_command) {
  return problem(Status::wrong_usage, std::move(what), std::move(why), std::move(hint));
}

// Returns the hint for an unknown word: the known word with the closest spelling, or `otherwise`.
std::string meant(std::string_view word, const std::vector<std::string>& known,
                  const std::string& before, const std::string& otherwise) {
  const std::vector<std::string_view> views(known.begin(), known.end());
  const std::string_view near = nearest(word, views);
  return near.empty() ? otherwise : before + std::string(near);
}

struct Found {
  const Command* command = nullptr;
  std::vector<std::string> rest;  // the words other than noun and verb
  std::string noun;               // for the help of one noun
};

// Returns whether the next word is this option's value, for any command. Where commands disagree
// (-t), it is not: the command is not known yet.
bool takes_value(std::string_view word, std::span<const Command> commands) {
  bool takes = false, is_flag = false;
  const auto look_at = [&](const Option& option) {
    if (!spellings_of(option).has(word)) return;
    (takes_next_word(option) ? takes : is_flag) = true;
  };
  look_at(options::socket);
  for (const Command& command : commands) {
    for (const Option* const option : command.options) look_at(*option);
  }
  return takes && !is_flag;
}

// Returns the command: the first words that are not options are its noun and verb.
Outcome<Found> find_command(std::span<const std::string> words, std::span<const Command> commands) {
  Found found;
  std::string noun, verb;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::string& word = words[i];
    if (word == "--") {
      found.rest.insert(found.rest.end(), words.begin() + static_cast<std::ptrdiff_t>(i),
                        words.end());
      break;
    }
    if (word.starts_with('-')) {
      found.rest.push_back(word);
      if (takes_value(word, commands) && i + 1 < words.size()) found.rest.push_back(words[++i]);
      continue;
    }
    const bool has_verb = std::any_of(commands.begin(), commands.end(), [&](const Command& c) {
      return c.noun == noun && !c.verb.empty();
    });
    if (noun.empty()) {
      noun = word;
      for (const Command& command : commands) {
        if (command.verb == "list" && plural_of(command.noun) == noun) {
          noun = command.noun;
          verb = command.verb;
        }
      }
    } else if (verb.empty() && has_verb) {
      verb = word;
    } else {
      found.rest.push_back(word);
    }
  }
  // Candidates for the hint, each as the user can run it.
  std::vector<std::string> nouns, verbs;
  for (const Command& command : commands) {
    if (command.verb == "list") nouns.push_back(plural_of(command.noun));
    nouns.emplace_back(command.noun);
    if (command.noun == noun) {
      verbs.emplace_back(command.verb);
      if (command.verb == verb) found.command = &command;
    }
  }
  if (found.command != nullptr || noun.empty()) return found;
  if (verbs.empty()) {
    const std::string hint =
        noun == "help" ? help_command : meant(noun, nouns, "agnocast-ctl ", help_command);
    const bool wants_verb = std::any_of(commands.begin(), commands.end(), [&](const Command& c) {
      return !c.verb.empty() && hint == "agnocast-ctl " + std::string(c.noun);
    });
    return wrong_usage(escaped(noun), "unknown command", wants_verb ? hint + " --help" : hint);
  }
  found.noun = noun;
  if (verb.empty()) return found;
  return wrong_usage(
      escaped(noun + ' ' + verb), "unknown command",
      meant(verb, verbs, "agnocast-ctl " + noun + ' ', "agnocast-ctl " + noun + " --help"));
}

std::optional<std::uint64_t> number_in(const std::string& text) {
  std::uint64_t number = 0;
  const char* const end = text.data() + text.size();
  const auto parsed = std::from_chars(text.data(), end, number);
  if (text.empty() || parsed.ec != std::errc() || parsed.ptr != end) return std::nullopt;
  return number;
}

std::optional<double> real_in(const std::string& text) {
  double number = 0;
  const char* const end = text.data() + text.size();
  const auto parsed = std::from_chars(text.data(), end, number);
  if (text.empty() || parsed.ec != std::errc() || parsed.ptr != end || !std::isfinite(number))
    return std::nullopt;
  return number;
}

std::vector<std::string> words_of(std::string_view text) {
  std::vector<std::string> words;
  while (!text.empty()) {
    const std::size_t blank = text.find(' ');
    words.emplace_back(text.substr(0, blank));
    text.remove_prefix(blank == std::string_view::npos ? text.size() : blank + 1);
  }
  return words;
}

Outcome<std::uint64_t> domain_of(const std::string& what, const std::string& text) {
  const auto number = number_in(text);
  if (!number || *number > domain_max)
    return wrong_usage(
        what,
        in_quotes(text) + " is not a domain; use a number from 0 to " + std::to_string(domain_max),
        "ROS_DOMAIN_ID=0 agnocast-ctl topic list");
  return *number;
}

/// Returns why `value` is not valid for its option; nothing if it is valid.
std::optional<std::string> complaint_of(const Option& option, const std::string& value) {
  const auto bound = [](double number) {
    char text[32];
    std::snprintf(text, sizeof text, "%.15g", number);
    return std::string(text);
  };
  switch (option.kind) {
    case Option::Kind::flag:
      return std::nullopt;
    case Option::Kind::text:
      if (!value.empty()) return std::nullopt;
      return "needs a " + std::string(option.value);
    case Option::Kind::whole: {
      const auto number = number_in(value);
      if (number && static_cast<double>(*number) >= option.least &&
          static_cast<double>(*number) <= option.most)
        return std::nullopt;
      return in_quotes(value) + " is not a whole number from " + bound(option.least) +
             (std::isinf(option.most) ? " upwards" : " to " + bound(option.most));
    }
    case Option::Kind::real: {
      const auto number = real_in(value);
      if (number && *number <= option.most &&
          (option.least == 0 ? *number > 0 : *number >= option.least))
        return std::nullopt;
      return in_quotes(value) + " is not a number " + (option.least == 0 ? "above " : "from ") +
             bound(option.least) + (std::isinf(option.most) ? "" : " to " + bound(option.most));
    }
    case Option::Kind::word: {
      const std::vector<std::string> words = words_of(option.words);
      if (std::find(words.begin(), words.end(), value) != words.end()) return std::nullopt;
      std::string known;
      for (const std::string& word : words) known += (known.empty() ? "" : ", ") + word;
      return in_quotes(value) + " is unknown; use one of " + known;
    }
  }
  return std::nullopt;
}

// CLI11 parses the options of one command; find_command() parses noun and verb.
class Parser {
 public:
  explicit Parser(const Command& command) : command_(command) {
    app_.allow_extras();  // refuse_extras() suggests a known option
    app_.set_help_flag("-h,--help");
    app_.add_option("SUBJECTS", arguments_.subjects);
    for (const Option* const option : command.options) add(*option);
    add(options::socket);
    add(options::json);
    add(options::json_form);
  }

  Outcome<std::variant<Arguments, Answer>> parse(std::vector<std::string> words,
                                                 const Surroundings& around) {
    const std::string help = full_name(command_) + " --help";
    // After "--" no word is an option.
    const auto mark = std::find(words.begin(), words.end(), "--");
    std::vector<std::string> plain(mark == words.end() ? mark : mark + 1, words.end());
    words.erase(mark, words.end());
    for (std::string& word : words) {
      // The next word is never its value.
      if (word == "--json") word += around.out_is_terminal ? "=pretty" : "=short";
    }
    std::reverse(words.begin(), words.end());  // CLI11 expects a vector in reverse order
    try {
      app_.parse(words);
    } catch (const CLI::CallForHelp&) {
      return Answer{help_of(command_)};
    } catch (const CLI::ParseError& error) {
      return wrong_usage("command line", escaped(error.what()), help);
    }
    if (auto known = refuse_extras(help); !known) return tl::unexpected(known.error());
    for (std::string& word : plain) arguments_.subjects.push_back(std::move(word));
    if (auto read = read_subjects(help); !read) return tl::unexpected(read.error());
    for (const auto& [option, value] : values_) {
      const std::string name(spellings_of(*option).longest);
      if (app_.count(name) == 0) continue;
      if (const auto why = complaint_of(*option, value)) return wrong_usage(name, *why, help);
      arguments_.given[option] = value;
    }
    arguments_.json = json_form(around);
    arguments_.all_domains =
        arguments_.has(options::all_domains) || arguments_.has(options::every_domain);
    if (takes(options::domain)) {
      auto chosen = read_domain(around);
      if (!chosen) return tl::unexpected(chosen.error());
      arguments_.domain = *chosen;
    }
    arguments_.socket = choose_socket(arguments_.text(options::socket), around);
    arguments_.command = &command_;
    return arguments_;
  }

 private:
  void add(const Option& option) {
    const std::string names(option.names);
    if (option.kind == Option::Kind::flag) {
      app_.add_flag(names)->disable_flag_override();
      values_[&option];
    } else {
      app_.add_option(names, values_[&option]);
    }
  }
  bool takes(const Option& option) const {
    return std::find(command_.options.begin(), command_.options.end(), &option) !=
           command_.options.end();
  }

  Outcome<void> refuse_extras(const std::string& help) {
    std::vector<std::string> known;
    for (const CLI::Option* const option : app_.get_options()) {
      for (const std::string& name : option->get_lnames()) known.push_back("--" + name);
    }
    for (const std::string& extra : app_.remaining()) {
      const std::string name = extra.substr(0, extra.find('='));
      return wrong_usage(escaped(name), "unknown option",
                         meant(name, known, full_name(command_) + ' ', help));
    }
    return {};
  }

  Outcome<void> read_subjects(const std::string& help) {
    const std::string example(command_.examples.substr(0, command_.examples.find('\n')));
    std::size_t read = 0;
    for (const Subject* const subject : command_.subjects) {
      const bool is_there = read < arguments_.subjects.size();
      if (!is_there && subject->count != Subject::Count::optional)
        return wrong_usage(std::string(subject->name), "is missing", example);
      if (is_there && arguments_.subjects[read].empty())
        return wrong_usage(std::string(subject->name), "is empty", example);
      read = subject->count == Subject::Count::many ? arguments_.subjects.size() : read + 1;
    }
    if (read < arguments_.subjects.size())
      return wrong_usage(escaped(arguments_.subjects[read]),
                         full_name(command_) + " takes no such argument", help);
    return {};
  }

  Json json_form(const Surroundings& around) const {
    const std::string form = arguments_.text(options::json_form);
    if (form == "short") return Json::compact;
    if (form == "pretty") return Json::pretty;
    if (form.empty() && !arguments_.has(options::json)) return Json::no;
    return around.out_is_terminal ? Json::pretty : Json::compact;
  }

  Outcome<std::uint64_t> read_domain(const Surroundings& around) {
    if (arguments_.has(options::domain))
      return domain_of("--domain", arguments_.text(options::domain));
    if (around.ros_domain_id) return domain_of("ROS_DOMAIN_ID", *around.ros_domain_id);
    return 0;
  }

  const Command& command_;
  Arguments arguments_;
  CLI::App app_;
  std::map<const Option*, std::string> values_;
};

std::optional<std::string> environment(const char* name) {
  const char* const value = ::secure_getenv(name);
  if (value == nullptr || *value == '\0') return std::nullopt;
  return value;
}

}  // namespace

std::string choose_socket(const std::string& named, const Surroundings& around) {
  if (!named.empty()) return named;
  if (around.agnocast_socket) return *around.agnocast_socket;
  if (around.has_system_socket || !around.xdg_runtime_dir) return system_socket;
  return *around.xdg_runtime_dir + user_socket;
}

std::string plural_of(std::string_view noun) {
  return std::string(noun) + (noun.ends_with('s') ? "es" : "s");
}

std::string full_name(const Command& command) {
  std::string name = std::string(program) + ' ' + std::string(command.noun);
  return command.verb.empty() ? name : name + ' ' + std::string(command.verb);
}

std::string usage_of(const Command& command) {
  std::string usage = full_name(command).substr(std::string_view(program).size() + 1);
  for (const Subject* const subject : command.subjects) {
    const std::string name(subject->name);
    switch (subject->count) {
      case Subject::Count::one:
        usage += ' ' + name;
        break;
      case Subject::Count::optional:
        usage += " [" + name + ']';
        break;
      case Subject::Count::many:
        usage += ' ' + name + "...";
        break;
    }
  }
  return usage;
}

std::string Arguments::text(const Option& option) const {
  const auto found = given.find(&option);
  return found != given.end() ? found->second : std::string(option.otherwise);
}
std::uint64_t Arguments::whole(const Option& option) const {
  return number_in(text(option)).value_or(0);
}
double Arguments::real(const Option& option) const { return real_in(text(option)).value_or(0); }

Surroundings Surroundings::of_process() {
  return {environment("AGNOCAST_SOCKET"), environment("XDG_RUNTIME_DIR"),
          environment("ROS_DOMAIN_ID"), ::access(system_socket, F_OK) == 0,
          ::isatty(STDOUT_FILENO) == 1};
}

Outcome<std::variant<Arguments, Answer>> parse_arguments(std::span<const std::string> words,
                                                         std::span<const Command> commands,
                                                         const Surroundings& around) {
  auto found = find_command(words, commands);
  if (!found) return tl::unexpected(found.error());
  if (std::count(found->rest.begin(), found->rest.end(), "--version") != 0)
    return Answer{version_text()};
  if (found->command != nullptr) {
    auto parsed = Parser(*found->command).parse(std::move(found->rest), around);
    if (!parsed) return parsed;
    if (auto* const arguments = std::get_if<Arguments>(&*parsed))
      arguments->words.assign(words.begin(), words.end());
    return parsed;
  }
  for (const std::string& word : found->rest) {
    if (word == "--help" || word == "-h") return Answer{help_of(commands, found->noun)};
    if (!takes_value(word, commands) && !word.starts_with("-j") && !word.starts_with("--json"))
      return wrong_usage(escaped(word), "unknown option");
  }
  if (!found->noun.empty())
    return wrong_usage(found->noun, "a verb is missing", "agnocast-ctl " + found->noun + " --help");
  return wrong_usage("command line", "a command is missing");
}

}  // namespace agnocast::ctl
