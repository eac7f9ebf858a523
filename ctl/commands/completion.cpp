// SPDX-License-Identifier: Apache-2.0

#include <ctl/commands/completion.hpp>

#include <agnocast/error.hpp>
#include <agnocast/service_name.hpp>
#include <ctl/cli/help.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>

#include <algorithm>
#include <set>
#include <string_view>

namespace agnocast::ctl {
namespace {

const Option* option_named(const Command* command, std::string_view word) {
  const auto is_it = [&](const Option* option) { return spellings_of(*option).has(word); };
  for (const Option* const option : common_options()) {
    if (is_it(option)) return option;
  }
  if (command == nullptr) return nullptr;
  const auto found = std::find_if(command->options.begin(), command->options.end(), is_it);
  return found == command->options.end() ? nullptr : *found;
}

/// The state of the command line in front of the cursor.
struct Place {
  std::string noun, verb;
  const Command* command = nullptr;
  const Option* wants_value = nullptr;
  std::size_t subjects = 0;
  bool only_subjects = false;  // after "--"
};

Place place_of(std::span<const std::string> words, std::span<const Command> commands) {
  Place place;
  for (const std::string& word : words) {
    if (place.wants_value != nullptr) {
      place.wants_value = nullptr;
    } else if (word == "--") {
      place.only_subjects = true;
    } else if (!place.only_subjects && word.starts_with('-')) {
      const Option* const option = option_named(place.command, word);
      if (option != nullptr && takes_next_word(*option)) place.wants_value = option;
    } else if (place.command != nullptr) {
      ++place.subjects;
    } else if (place.noun.empty()) {
      place.noun = word;
      for (const Command& command : commands) {
        if ((command.noun == word && command.verb.empty()) ||
            (command.verb == "list" && plural_of(command.noun) == word))
          place.command = &command;
      }
    } else {
      place.verb = word;
      for (const Command& command : commands) {
        if (command.noun == place.noun && command.verb == word) place.command = &command;
      }
    }
  }
  return place;
}

const Subject* subject_at(const Command& command, std::size_t index) {
  if (index < command.subjects.size()) return command.subjects[index];
  if (command.subjects.empty() || command.subjects.back()->count != Subject::Count::many)
    return nullptr;
  return command.subjects.back();
}

}  // namespace

std::vector<std::string> completions_of(std::span<const std::string> words,
                                        std::span<const Command> commands,
                                        const NameSource& names) {
  if (words.empty()) return {};
  const std::string& typed = words.back();
  const Place place = place_of(words.first(words.size() - 1), commands);
  std::set<std::string> all;
  const auto add_names = [&](Names kind) {
    if (kind == Names::none) return;
    for (std::string& name : names(kind)) all.insert(std::move(name));
  };
  if (place.wants_value != nullptr) {
    std::string_view rest = place.wants_value->words;
    while (!rest.empty()) {
      const std::size_t blank = rest.find(' ');
      all.emplace(rest.substr(0, blank));
      rest.remove_prefix(blank == std::string_view::npos ? rest.size() : blank + 1);
    }
    add_names(place.wants_value->names_of_value);
  } else if (!place.only_subjects && typed.starts_with('-')) {
    for (const Option* const option : common_options()) all.emplace(spellings_of(*option).longest);
    if (place.command != nullptr) {
      for (const Option* const option : place.command->options)
        all.emplace(spellings_of(*option).longest);
    }
  } else if (place.command != nullptr) {
    if (const Subject* const subject = subject_at(*place.command, place.subjects))
      add_names(subject->names);
  } else {
    for (const Command& command : commands) {
      if (place.noun.empty()) all.emplace(command.noun);
      if (command.noun == place.noun && place.verb.empty()) all.emplace(command.verb);
    }
  }
  // A shell inserts completions as they are. Any connected user chooses names, and a process name
  // may hold any character, so only names without special meaning to a shell are offered.
  const auto is_harmless = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
           std::string_view("_/.:-").find(c) != std::string_view::npos;
  };
  std::vector<std::string> matching;
  for (const std::string& word : all) {
    if (word.starts_with(typed) && std::all_of(word.begin(), word.end(), is_harmless))
      matching.push_back(word);
  }
  return matching;
}

std::vector<std::string> names_from(const std::string& socket, Names kind) {
  std::vector<std::string> names;
  if (kind == Names::codes) {
    for (int number = 1; *remedy_of(static_cast<Errc>(number)) != '\0'; ++number)
      names.emplace_back(word_of(static_cast<Errc>(number)));
    return names;
  }
  if (kind == Names::levels) return {"error", "warning", "notice", "info", "debug"};
  const auto look = look_at(socket);
  if (!look) return names;
  Arguments everywhere;
  everywhere.all_domains = true;
  for (const auto& [index, topic] : look->system.topics) {
    if (kind == Names::topics ||
        (kind == Names::topics_and_services && !is_service_topic(topic.name)))
      names.push_back(topic.name);
    if (kind == Names::types) names.push_back(topic.type);
  }
  if (kind == Names::services || kind == Names::service_types ||
      kind == Names::topics_and_services) {
    for (const Service& service : services_of(look->system, everywhere))
      names.push_back(kind == Names::service_types ? service.type : service.name);
  }
  if (kind == Names::nodes) {
    for (const Node& node : nodes_of(look->system, everywhere)) names.push_back(node.full_name());
  }
  if (kind == Names::processes) {
    for (const auto& [index, process] : look->system.processes)
      names.push_back(std::to_string(process.facts.pid));
  }
  return names;
}

}  // namespace agnocast::ctl
