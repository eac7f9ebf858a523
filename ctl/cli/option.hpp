// SPDX-License-Identifier: Apache-2.0
//
// Option: one option of agnocast-ctl as data. Parsing, help, manual and completion are made from
// it, and a command passes the object itself to get the value:
//
//   namespace options { inline constexpr Option window{…}; }
//   arguments.whole(options::window)
//
// Options that mean the same as in `ros2` use the same letters.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <string_view>

namespace agnocast::ctl {

/// The names that completion offers for a word.
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
  std::string_view meaning;  // a phrase that follows the name
  Kind kind = Kind::flag;
  std::string_view value = {};      // the value's name in help: "COUNT"
  std::string_view otherwise = {};  // the default; empty: none
  double least = 0;
  double most = std::numeric_limits<double>::infinity();
  std::string_view words = {};  // separated by blanks
  Names names_of_value = Names::none;
};

/// The spellings of an option, the long one last: "-n", "--number"; equal if there is only one.
struct Spellings {
  std::string_view first, longest;
  constexpr bool has(std::string_view word) const { return word == first || word == longest; }
};
constexpr Spellings spellings_of(const Option& option) {
  const std::size_t comma = option.names.find(',');
  if (comma == std::string_view::npos) return {option.names, option.names};
  return {option.names.substr(0, comma), option.names.substr(comma + 1)};
}
/// Returns whether the next word is its value: not for a flag or a value that follows "=".
constexpr bool takes_next_word(const Option& option) {
  return option.kind != Option::Kind::flag && !option.value.starts_with('[');
}

/// A word that is not an option.
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

// Options of all commands.
inline constexpr Option socket{
    "--socket", "the socket of agnocastd; default: AGNOCAST_SOCKET, else the usual path",
    Kind::text, "PATH"};
inline constexpr Option json{"-j", "print one JSON object, indented on a terminal"};
inline constexpr Option json_form{
    "--json", "the same on one line, or indented", Kind::word, "[=FORM]", {}, 0, 0, "short pretty"};

// Options that select.
inline constexpr Option domain{"--domain", "the ROS domain; default: ROS_DOMAIN_ID, else 0",
                               Kind::text, "ID"};
inline constexpr Option all_domains{"-a,--all-domains", "show every ROS domain"};
inline constexpr Option every_domain{"--all-domains", "show every ROS domain"};
inline constexpr Option hidden_nodes{"-a,--all",
                                     "also show nodes whose name begins with an underscore"};
inline constexpr Option hidden{"--include-hidden-topics",
                               "also show names with a part that begins with an underscore"};
inline constexpr Option hidden_services{
    "--include-hidden-services", "also show names with a part that begins with an underscore"};
inline constexpr Option of_topic{"--topic", "only this topic", Kind::text, "NAME", {}, 0, 0,
                                 {},        Names::topics};
inline constexpr Option of_process{
    "--process",     "only this process, by name or pid", Kind::text, "NAME", {}, 0, 0, {},
    Names::processes};

// Options that set how much is shown.
inline constexpr Option show_types{"-t,--show-types", "also show the type of each"};
inline constexpr Option count_topics{"-c,--count-topics", "print only the number"};
inline constexpr Option count_services{"-c,--count-services", "print only the number"};
inline constexpr Option count_nodes{"-c,--count-nodes", "print only the number"};
inline constexpr Option verbose{"-v,--verbose", "show more of each"};
inline constexpr Option records{
    "-n,--number", "print at most COUNT, the newest", Kind::whole, "COUNT", "20", 1};
inline constexpr Option follow{"-f,--follow", "then print new ones as they come"};
inline constexpr Option window{
    "-w,--window", "measure over at most COUNT messages", Kind::whole, "COUNT", "10000", 2, 1e6};
inline constexpr Option bandwidth_window{
    "-w,--window", "measure over at most COUNT messages", Kind::whole, "COUNT", "100", 2, 1e6};
inline constexpr Option reports{
    "-n,--number", "end after COUNT reports, one a second", Kind::whole, "COUNT", {}, 1};
inline constexpr Option batch{"-b,--batch", "print lines and read no keys, for programs and files"};
inline constexpr Option rounds{
    "-n,--number", "end after COUNT rounds", Kind::whole, "COUNT", {}, 1};
inline constexpr Option delay{
    "-d,--delay", "seconds between two rounds", Kind::real, "SECONDS", "0.5", 0.05, 3600};
inline constexpr Option sort{"-s,--sort", "the order of the rows",
                             Kind::word,  "COLUMN",
                             "trouble",   0,
                             0,           "trouble topic rate size bandwidth lag hold lost"};
inline constexpr Option graph_form{"--format", "the language", Kind::word, "FORM", "dot", 0,
                                   0,          "dot mermaid"};
inline constexpr Option metrics_form{
    "--format", "the format", Kind::word, "FORM", "prometheus", 0, 0, "prometheus openmetrics"};
inline constexpr Option output{
    "-o,--output", "replace this file atomically; default: print to stdout", Kind::text, "FILE"};
inline constexpr Option every{
    "--every", "repeat every SECONDS; needs --output", Kind::real, "SECONDS", {}, 1, 86400};
inline constexpr Option user{"--user", "the user, by name or number; default: the caller",
                             Kind::text, "USER"};
inline constexpr Option watch{"-w,--watch", "repeat whenever something has changed"};
inline constexpr Option bridge_delay{
    "-d,--delay", "seconds over which rates are measured", Kind::real, "SECONDS", "0.5", 0.05,
    3600};
inline constexpr Option bridge_watch{"-w,--watch", "repeat after each delay"};
inline constexpr Option include_warnings{"-w,--include-warnings",
                                         "count warnings as failed checks"};
inline constexpr Option list_checks{"-l,--list", "list all checks with cause and remedy"};

}  // namespace options

namespace subjects {

inline constexpr Subject topic{"NAME", "a topic; a missing leading slash is added", Names::topics};
inline constexpr Subject topics{"NAME", "topics; a missing leading slash is added", Names::topics,
                                Subject::Count::many};
inline constexpr Subject maybe_topic{"NAME", "only of this topic", Names::topics,
                                     Subject::Count::optional};
inline constexpr Subject type{"TYPE", "a message type: std_msgs/msg/String", Names::types};
inline constexpr Subject service{"NAME", "a service; a missing leading slash is added",
                                 Names::services};
inline constexpr Subject topic_or_service{
    "NAME", "a topic or service; a missing leading slash is added", Names::topics_and_services};
inline constexpr Subject service_type{"TYPE", "a service type: std_srvs/srv/Trigger",
                                      Names::service_types};
inline constexpr Subject node{"NODE", "a node, with its namespace", Names::nodes};
inline constexpr Subject process{
    "PROCESS", "a pid, or INDEX.GENERATION as process list shows it (CLIENT)", Names::processes};
inline constexpr Subject named_process{
    "PROCESS", "a pid, a name, or INDEX.GENERATION as process list shows it (CLIENT)",
    Names::processes};
inline constexpr Subject code{"CODE", "the code of an error, by name or number", Names::codes,
                              Subject::Count::optional};
inline constexpr Subject level{"LEVEL", "error, warning, notice, info or debug", Names::levels,
                               Subject::Count::optional};

}  // namespace subjects

}  // namespace agnocast::ctl
