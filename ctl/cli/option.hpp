// SPDX-License-Identifier: Apache-2.0
//
// Option: one option of agnocast-ctl as data. Parsing, help, manual and completion are made from it,
// and a command asks for its value by the object itself:
//
//   namespace options { inline constexpr Option window{…}; }
//   arguments.whole(options::window)
//
// Options are few and shared: who means the same thing as ros2's verbs takes their letters.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <string_view>

namespace agnocast::ctl {

/// What completion offers for a word.
enum class Names : std::uint8_t {
  none,
  topics,
  topics_and_services,
  types,
  services,
  service_types,
  nodes,
  processes,
  codes,
  levels
};

struct Option {
  enum class Kind : std::uint8_t {
    flag,   // no value
    text,   // anything but the empty text
    whole,  // a whole number from `least` to `most`
    real,   // a number from `least` (above it, when that is 0) to `most`
    word,   // one of `words`
  };

  std::string_view names;    // as typed: "-t,--show-types"
  std::string_view meaning;  // a phrase that goes on behind the name
  Kind kind = Kind::flag;
  std::string_view value = {};      // what help calls the value: "COUNT"
  std::string_view otherwise = {};  // the value when it is not given; empty: none
  double least = 0;
  double most = std::numeric_limits<double>::infinity();
  std::string_view words = {};  // separated by blanks
  Names names_of_value = Names::none;
};

/// The ways to type it, the long one last: "-n" and "--number"; equal when there is only one.
struct Spellings {
  std::string_view first, longest;
  constexpr bool has(std::string_view word) const { return word == first || word == longest; }
};
constexpr Spellings spellings_of(const Option& option) {
  const std::size_t comma = option.names.find(',');
  if (comma == std::string_view::npos) return {option.names, option.names};
  return {option.names.substr(0, comma), option.names.substr(comma + 1)};
}
/// Is the next word its value? Not of one whose value stands behind "=" or not at all.
constexpr bool takes_next_word(const Option& option) {
  return option.kind != Option::Kind::flag && !option.value.starts_with('[');
}

/// A word that is no option.
struct Subject {
  enum class Count : std::uint8_t { one, optional, many };  // many: one or more, at the end
  std::string_view name;                                    // "TOPIC"
  std::string_view meaning;
  Names names = Names::none;
  Count count = Count::one;
};

template <const Option&... Each>
inline constexpr std::array<const Option*, sizeof...(Each)> these{&Each...};
template <const Subject&... Each>
inline constexpr std::array<const Subject*, sizeof...(Each)> about{&Each...};

namespace options {

using Kind = Option::Kind;

// Of all commands.
inline constexpr Option socket{
    "--socket", "where agnocastd listens; else AGNOCAST_SOCKET, else the usual place", Kind::text,
    "PATH"};
inline constexpr Option json{"-j", "one JSON object; indented on a terminal"};
inline constexpr Option json_form{
    "--json", "the same; FORM is short or pretty", Kind::word, "[=FORM]", {}, 0, 0, "short pretty"};

// Which of all.
inline constexpr Option domain{"--domain", "of this ROS domain; else ROS_DOMAIN_ID, else 0",
                               Kind::text, "ID"};
inline constexpr Option all_domains{"-a,--all-domains", "of every ROS domain"};
inline constexpr Option every_domain{"--all-domains", "of every ROS domain"};
inline constexpr Option hidden_nodes{"-a,--all", "also those whose name begins with an underscore"};
inline constexpr Option hidden{"--include-hidden-topics",
                               "also those with a part that begins with an underscore"};
inline constexpr Option hidden_services{"--include-hidden-services",
                                        "also those with a part that begins with an underscore"};
inline constexpr Option of_topic{"--topic", "of this topic", Kind::text, "NAME", {}, 0, 0,
                                 {},        Names::topics};
inline constexpr Option of_process{
    "--process",     "of this process: its name or pid", Kind::text, "NAME", {}, 0, 0, {},
    Names::processes};

// How much of each.
inline constexpr Option show_types{"-t,--show-types", "with the type of each"};
inline constexpr Option count_topics{"-c,--count-topics", "only how many there are"};
inline constexpr Option count_services{"-c,--count-services", "only how many there are"};
inline constexpr Option count_nodes{"-c,--count-nodes", "only how many there are"};
inline constexpr Option verbose{"-v,--verbose", "more of each"};
inline constexpr Option records{
    "-n,--number", "at most so many, the newest", Kind::whole, "COUNT", "20", 1};
inline constexpr Option follow{"-f,--follow", "go on with what comes"};
inline constexpr Option window{
    "-w,--window", "over at most so many messages", Kind::whole, "COUNT", "10000", 2, 1e6};
inline constexpr Option bandwidth_window{
    "-w,--window", "over at most so many messages", Kind::whole, "COUNT", "100", 2, 1e6};
inline constexpr Option reports{
    "-n,--number", "end after so many reports, one a second", Kind::whole, "COUNT", {}, 1};
inline constexpr Option batch{"-b,--batch", "print, and take no keys; for programs and files"};
inline constexpr Option rounds{
    "-n,--number", "end after so many rounds", Kind::whole, "COUNT", {}, 1};
inline constexpr Option delay{
    "-d,--delay", "seconds between two rounds", Kind::real, "SECONDS", "0.5", 0.05, 3600};
inline constexpr Option sort{"-s,--sort", "the order of the rows",
                             Kind::word,  "COLUMN",
                             "trouble",   0,
                             0,           "trouble topic rate size bandwidth lag hold lost"};
inline constexpr Option graph_form{"--format", "dot or mermaid", Kind::word, "FORM", "dot", 0,
                                   0,          "dot mermaid"};
inline constexpr Option metrics_form{
    "--format", "prometheus or openmetrics", Kind::word, "FORM", "prometheus", 0,
    0,          "prometheus openmetrics"};
inline constexpr Option output{"-o,--output", "into this file, as a whole; else to stdout",
                               Kind::text, "FILE"};
inline constexpr Option every{
    "--every", "go on: again every so many seconds; needs --output", Kind::real, "SECONDS", {}, 1,
    86400};
inline constexpr Option user{"--user", "what this one may, by name or number; else who runs it",
                             Kind::text, "USER"};
inline constexpr Option watch{"-w,--watch", "go on: once more whenever something has changed"};
inline constexpr Option bridge_delay{
    "-d,--delay", "seconds over which rates are measured", Kind::real, "SECONDS", "0.5", 0.05,
    3600};
inline constexpr Option bridge_watch{"-w,--watch", "go on: once more after each delay"};
inline constexpr Option include_warnings{"-w,--include-warnings",
                                         "count warnings as failed checks"};
inline constexpr Option list_checks{"-l,--list", "what is checked, and how each is mended"};

}  // namespace options

namespace subjects {

inline constexpr Subject topic{"NAME", "a topic; without a slash it is meant to have one",
                               Names::topics};
inline constexpr Subject topics{"NAME", "topics; without a slash they are meant to have one",
                                Names::topics, Subject::Count::many};
inline constexpr Subject maybe_topic{"NAME", "only of this topic", Names::topics,
                                     Subject::Count::optional};
inline constexpr Subject type{"TYPE", "a message type: std_msgs/msg/String", Names::types};
inline constexpr Subject service{"NAME", "a service; without a slash it is meant to have one",
                                 Names::services};
inline constexpr Subject topic_or_service{
    "NAME", "a topic or service; without a slash it is meant to have one",
    Names::topics_and_services};
inline constexpr Subject service_type{"TYPE", "a service type: std_srvs/srv/Trigger",
                                      Names::service_types};
inline constexpr Subject node{"NODE", "a node, with its namespace", Names::nodes};
inline constexpr Subject process{
    "PROCESS", "a pid, or INDEX.GENERATION as process list has it (CLIENT)", Names::processes};
inline constexpr Subject named_process{
    "PROCESS", "a pid, a name, or INDEX.GENERATION as process list has it (CLIENT)",
    Names::processes};
inline constexpr Subject code{"CODE", "a code that an error named, or its number", Names::codes,
                              Subject::Count::optional};
inline constexpr Subject level{"LEVEL", "error, warning, notice, info or debug", Names::levels,
                               Subject::Count::optional};

}  // namespace subjects

}  // namespace agnocast::ctl
