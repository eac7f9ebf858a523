// SPDX-License-Identifier: Apache-2.0

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/version.hpp>
#include <base/text.hpp>
#include <ctl/commands.hpp>

#include <CLI/CLI.hpp>

#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <vector>

namespace agnocast::ctl {
namespace {

constexpr const char* program = "agnocast-ctl";
constexpr const char* help_command = "agnocast-ctl --help";
constexpr const char* system_socket = "/run/agnocast/agnocastd.sock";
// ROS 2's own bound; a higher one has no DDS ports.
constexpr std::uint64_t domain_max = 232;

std::string full_name(const Command& command) {
  std::string name = std::string(program) + ' ' + std::string(command.noun);
  return command.verb.empty() ? name : name + ' ' + std::string(command.verb);
}

std::string plural_of(std::string_view noun) {
  return std::string(noun) + (noun.ends_with('s') ? "es" : "s");
}

std::string version_text() {
  char text[96];
  std::snprintf(text, sizeof text, "agnocast-ctl %d.%d.%d (layout %016llx)\n",
                AGNOCAST_VERSION_MAJOR, AGNOCAST_VERSION_MINOR, AGNOCAST_VERSION_PATCH,
                static_cast<unsigned long long>(abi::fingerprint()));
  return text;
}

/// The word that names what a command is about; empty when it takes none.
std::string subject_of(const Command& command) {
  if (command.takes & a_name) return "NAME";
  return command.takes & a_process ? "PROCESS" : "";
}

std::string usage_of(const Command& command) {
  std::string usage = std::string(command.noun);
  if (!command.verb.empty()) usage += ' ' + std::string(command.verb);
  if (const std::string subject = subject_of(command); !subject.empty()) usage += ' ' + subject;
  return usage;
}

/// Help of everything, or of one noun.
std::string help_text(std::span<const Command> commands, std::string_view noun) {
  std::string text =
      "Looks at agnocast: topics, processes, shared heaps. Looking never disturbs; only revoke "
      "changes\nanything.\n\n"
      "Usage: agnocast-ctl NOUN [VERB] [NAME] [OPTION...]\n\n";
  std::string examples;
  std::size_t width = 0;
  for (const Command& command : commands) width = std::max(width, usage_of(command).size());
  for (const Command& command : commands) {
    if (!noun.empty() && command.noun != noun) continue;
    std::string usage = usage_of(command);
    usage.resize(width + 2, ' ');
    text += "  " + usage + std::string(command.summary) + '\n';
    const std::string_view all = command.examples;
    examples += "  " + std::string(all.substr(0, all.find('\n'))) + '\n';
  }
  text += "\nPlural nouns are short for list: ";
  bool first = true;
  for (const Command& command : commands) {
    if (command.verb != "list") continue;
    text += (first ? "" : ", ") + plural_of(command.noun);
    first = false;
  }
  text +=
      ".\n\nOptions of all:\n"
      "  --socket PATH          where agnocastd listens; else AGNOCAST_SOCKET, else the usual "
      "place\n"
      "  -j, --json[=FORM]      one JSON object; FORM is short or pretty\n"
      "  --version              print version and layout of shared memory\n"
      "  -h, --help             print this; after a command, its options\n"
      "\nExamples:\n" +
      examples +
      "\nExit status: 0 done, 1 failed, 2 wrong usage, 3 daemon not reachable, 4 no such topic, "
      "node "
      "or\nprocess, 5 permission denied, 6 a check of verify failed.\n";
  return text;
}

tl::unexpected<Problem> wrong_usage(std::string what, std::string why,
                                    std::string hint = help_command) {
  return problem(Status::wrong_usage, std::move(what), std::move(why), std::move(hint));
}

// "hint: did you mean …": the word that is spelt most alike, or the help.
std::string meant(std::string_view word, const std::vector<std::string>& known,
                  const std::string& before, const std::string& otherwise) {
  const std::vector<std::string_view> views(known.begin(), known.end());
  const std::string_view near = nearest(word, views);
  return near.empty() ? otherwise : before + std::string(near);
}

struct Found {
  const Command* command = nullptr;
  std::vector<std::string> rest;  // the words that are not the command's own
  std::string noun;               // for help of a noun
};

// Options that are followed by their value.
bool takes_value(std::string_view word) {
  constexpr std::string_view options[] = {"--socket", "--domain", "-n",
                                          "--number", "--topic",  "--process"};
  return std::find(std::begin(options), std::end(options), word) != std::end(options);
}

// The first words that are no options are noun and verb.
Outcome<Found> find_command(std::span<const std::string> words, std::span<const Command> commands) {
  Found found;
  std::string noun, verb;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::string& word = words[i];
    if (word.starts_with('-')) {
      found.rest.push_back(word);
      if (takes_value(word) && i + 1 < words.size()) found.rest.push_back(words[++i]);
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
  // What may have been meant, each as it can be run.
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

Outcome<std::uint64_t> domain_of(const std::string& what, const std::string& text) {
  const auto number = number_in(text);
  if (!number || *number > domain_max)
    return wrong_usage(
        what,
        in_quotes(text) + " is no domain; it is a number from 0 to " + std::to_string(domain_max),
        "ROS_DOMAIN_ID=0 agnocast-ctl topic list");
  return *number;
}

std::string choose_socket(const std::string& named, const Surroundings& around) {
  if (!named.empty()) return named;
  if (around.agnocast_socket) return *around.agnocast_socket;
  if (around.has_system_socket || !around.xdg_runtime_dir) return system_socket;
  return *around.xdg_runtime_dir + "/agnocast/agnocastd.sock";
}

// CLI11 reads the options of one command; nouns and verbs are ours.
class Parser {
 public:
  explicit Parser(const Command& command)
      : command_(command), app_(std::string(command.summary), full_name(command)) {
    app_.allow_extras();  // so that we can say what is unknown, and what was meant
    app_.set_help_flag("-h,--help", "print this and end");
    if (command.takes & a_name)
      app_.add_option("NAME", arguments_.name, "a topic; without a slash it is meant to have one");
    if (command.takes & a_process)
      app_.add_option("PROCESS", arguments_.name,
                      "a pid, or INDEX.GENERATION as process list has it (CLIENT)");
    flag("-t,--show-types", types, arguments_.types, "with the type of each");
    flag("-c,--count-topics", count, arguments_.count, "only how many there are");
    flag("-v,--verbose", verbose, arguments_.verbose, "more of each");
    flag("--include-hidden-topics", hidden, arguments_.hidden,
         "also those with a part that begins with an underscore");
    flag("-a,--all-domains", domains, arguments_.all_domains, "of every ROS domain");
    if (command.takes & domain)
      app_.add_option("--domain", domain_, "of this ROS domain; else ROS_DOMAIN_ID, else 0")
          ->type_name("ID");
    flag("-f,--follow", records, arguments_.follow, "go on with what comes");
    if (command.takes & records) {
      app_.add_option("-n,--number", number_, "at most so many, the newest; else 20")
          ->type_name("COUNT");
      app_.add_option("--topic", arguments_.topic, "of this topic")->type_name("NAME");
      app_.add_option("--process", arguments_.process, "of this process: its name or pid")
          ->type_name("NAME");
    }
    app_.add_option("--socket", arguments_.socket, "where agnocastd listens")->type_name("PATH");
    app_.add_option("--json", json_, "one JSON object; short or pretty")->type_name("[=FORM]");
    app_.add_flag("-j", json_flag_, "the same");
    app_.footer("Examples:\n" + std::string(command.examples));
    for (CLI::Option* const option : app_.get_options()) {
      if (option->get_expected_max() == 0) option->disable_flag_override();
    }
  }

  Outcome<std::variant<Arguments, Answer>> parse(std::vector<std::string> words,
                                                 const Surroundings& around) {
    const std::string help = full_name(command_) + " --help";
    for (std::string& word : words) {
      if (word == "--json") word = "--json=auto";  // its value is never the next word
    }
    std::reverse(words.begin(), words.end());  // as CLI11 wants a vector
    try {
      app_.parse(words);
    } catch (const CLI::CallForHelp&) {
      return Answer{app_.help()};
    } catch (const CLI::ParseError& error) {
      return wrong_usage("command line", escaped(error.what()), help);
    }
    if (auto known = refuse_extras(help); !known) return tl::unexpected(known.error());
    if (const std::string subject = subject_of(command_);
        !subject.empty() && arguments_.name.empty())
      return wrong_usage(subject, "is missing",
                         std::string(command_.examples.substr(0, command_.examples.find('\n'))));
    if (auto form = read_json(around, help); !form) return tl::unexpected(form.error());
    if (command_.takes & domain) {
      auto chosen = read_domain(around);
      if (!chosen) return tl::unexpected(chosen.error());
      arguments_.domain = *chosen;
    }
    if (auto counted = read_number(help); !counted) return tl::unexpected(counted.error());
    if (app_.count("--socket") != 0 && arguments_.socket.empty())
      return wrong_usage("--socket", "needs a path", help);
    arguments_.socket = choose_socket(arguments_.socket, around);
    arguments_.command = &command_;
    return arguments_;
  }

 private:
  void flag(const char* name, Takes which, bool& target, const char* meaning) {
    if ((command_.takes & which) == which) app_.add_flag(name, target, meaning);
  }

  Outcome<void> refuse_extras(const std::string& help) {
    std::vector<std::string> known;
    for (const CLI::Option* const option : app_.get_options()) {
      for (const std::string& name : option->get_lnames()) known.push_back("--" + name);
    }
    for (const std::string& extra : app_.remaining()) {
      if (extra.size() < 2 || extra[0] != '-')
        return wrong_usage(escaped(extra), full_name(command_) + " takes no such word", help);
      const std::string name = extra.substr(0, extra.find('='));
      return wrong_usage(escaped(name), "unknown option",
                         meant(name, known, full_name(command_) + ' ', help));
    }
    return {};
  }

  Outcome<void> read_json(const Surroundings& around, const std::string& help) {
    if (app_.count("--json") == 0 && !json_flag_) return {};
    if (json_.empty() || json_ == "auto") {
      arguments_.json = around.out_is_terminal ? Json::pretty : Json::compact;
    } else if (json_ == "short" || json_ == "pretty") {
      arguments_.json = json_ == "short" ? Json::compact : Json::pretty;
    } else {
      return wrong_usage("--json", in_quotes(json_) + " is no form; known: short, pretty", help);
    }
    return {};
  }

  Outcome<void> read_number(const std::string& help) {
    if (!(command_.takes & records) || app_.count("--number") == 0) return {};
    const auto number = number_in(number_);
    if (!number || *number == 0)
      return wrong_usage("--number", in_quotes(number_) + " is no number from 1 upwards", help);
    arguments_.number = *number;
    return {};
  }

  Outcome<std::uint64_t> read_domain(const Surroundings& around) {
    if (app_.count("--domain") != 0) return domain_of("--domain", domain_);
    if (around.ros_domain_id) return domain_of("ROS_DOMAIN_ID", *around.ros_domain_id);
    return 0;
  }

  const Command& command_;
  Arguments arguments_;
  CLI::App app_;
  std::string domain_, json_, number_;
  bool json_flag_ = false;
};

std::optional<std::string> environment(const char* name) {
  const char* const value = std::getenv(name);
  if (value == nullptr || *value == '\0') return std::nullopt;
  return value;
}

}  // namespace

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
  if (found->command != nullptr)
    return Parser(*found->command).parse(std::move(found->rest), around);
  for (const std::string& word : found->rest) {
    if (word == "--help" || word == "-h") return Answer{help_text(commands, found->noun)};
    if (!takes_value(word) && !word.starts_with("-j") && !word.starts_with("--json"))
      return wrong_usage(escaped(word), "unknown option");
  }
  if (!found->noun.empty())
    return wrong_usage(found->noun, "a verb is missing", "agnocast-ctl " + found->noun + " --help");
  return wrong_usage("command line", "a command is missing");
}

}  // namespace agnocast::ctl
