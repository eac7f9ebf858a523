// SPDX-License-Identifier: Apache-2.0
//
// Options of the commands that take part: ros2's letters and words.
#pragma once

#include <ctl/cli/option.hpp>

namespace agnocast::ctl {

namespace options {

// Quality of service.
inline constexpr Option qos_profile{
    "--qos-profile",
    "a preset, which the other --qos options change",
    Kind::word,
    "PROFILE",
    {},
    0,
    0,
    "default system_default sensor_data services_default parameters parameter_events "
    "action_status_default best_available"};
inline constexpr Option qos_depth{"--qos-depth", "messages of history", Kind::whole, "COUNT", {}, 1,
                                  1 << 20};
inline constexpr Option qos_history{"--qos-history",
                                    "how messages are kept",
                                    Kind::word,
                                    "WORD",
                                    {},
                                    0,
                                    0,
                                    "keep_last keep_all system_default"};
inline constexpr Option qos_reliability{"--qos-reliability",
                                        "what happens to messages that are not read in time",
                                        Kind::word,
                                        "WORD",
                                        {},
                                        0,
                                        0,
                                        "reliable best_effort system_default best_available"};
inline constexpr Option qos_durability{"--qos-durability",
                                       "whether late joiners get what was published before",
                                       Kind::word,
                                       "WORD",
                                       {},
                                       0,
                                       0,
                                       "volatile transient_local system_default best_available"};

// What is printed of a message.
inline constexpr Option field{"--field", "this part alone: pose.position.x, points[2]", Kind::text,
                              "PLACE"};
inline constexpr Option csv{"--csv", "all values of a message on a line, between commas"};
inline constexpr Option raw{"--raw", "the bytes of the message object, in hexadecimal"};
inline constexpr Option no_arr{"--no-arr", "of arrays only type and length"};
inline constexpr Option no_str{"--no-str", "of strings only their length"};
inline constexpr Option full_length{"-f,--full-length", "arrays and strings to their end"};
inline constexpr Option truncate_length{
    "-l,--truncate-length", "of arrays and strings at most so much; JSON is whole without it",
    Kind::whole, "COUNT", "128"};
inline constexpr Option filter{"--filter",
                               "only messages for which this holds: 'm.data > 3 and m.ok'",
                               Kind::text, "EXPRESSION"};
inline constexpr Option message_info{"-i,--include-message-info",
                                     "with time stamps and sequence numbers"};

// How long.
inline constexpr Option once_echo{"--once", "end after the first message"};
inline constexpr Option message_count{
    "-n,--number", "end after so many messages", Kind::whole, "COUNT", {}, 1};
inline constexpr Option timeout{"--timeout",
                                "end after so many seconds, with status 124 if too little came",
                                Kind::real, "SECONDS"};

// Publishing.
inline constexpr Option once_pub{"-1,--once", "one message, and end"};
inline constexpr Option rate{"-r,--rate", "messages a second", Kind::real, "RATE", "1", 0, 1e6};
inline constexpr Option call_rate{
    "-r,--rate", "call again and again, so many times a second", Kind::real, "RATE", {}, 0, 1e6};
inline constexpr Option times{
    "-t,--times", "end after so many messages", Kind::whole, "COUNT", {}, 1};
inline constexpr Option wait_matching{
    "-w,--wait-matching-subscriptions",
    "publish when so many subscriptions are there; else 1 with --once and --times, 0 without",
    Kind::whole, "COUNT"};
inline constexpr Option max_wait{"--max-wait-time-secs",
                                 "wait no longer for them; then end with status 124", Kind::real,
                                 "SECONDS"};
inline constexpr Option keep_alive{"--keep-alive", "stay so long after the last message",
                                   Kind::real, "SECONDS", "0.1"};
inline constexpr Option print_each{"-p,--print", "print every N-th message; 0: none", Kind::whole,
                                   "N", "1"};
inline constexpr Option from_stdin{"--stdin", "the values come from standard input"};
inline constexpr Option yaml_file{
    "--yaml-file", "each document of this file is a message, sent in turn", Kind::text, "FILE"};
inline constexpr Option node_name{"--node-name", "what the node is called", Kind::text, "NAME"};

}  // namespace options

namespace subjects {

inline constexpr Subject optional_type{"TYPE", "such as std_msgs/msg/String; else the topic's",
                                       Names::types, Subject::Count::optional};
inline constexpr Subject values{"VALUES", "YAML: '{data: hello}'; else a default message",
                                Names::none, Subject::Count::optional};

}  // namespace subjects

}  // namespace agnocast::ctl
