// SPDX-License-Identifier: Apache-2.0
//
// Options of the commands that publish or subscribe, with ros2's letters and words.
#pragma once

#include <ctl/cli/option.hpp>

namespace agnocast::ctl {

namespace options {

// Quality of service.
inline constexpr Option qos_profile{
    "--qos-profile",
    "a preset that the other --qos options modify",
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
                                        "whether delivery is reliable or best effort",
                                        Kind::word,
                                        "WORD",
                                        {},
                                        0,
                                        0,
                                        "reliable best_effort system_default best_available"};
inline constexpr Option qos_durability{"--qos-durability",
                                       "whether late joiners get earlier messages",
                                       Kind::word,
                                       "WORD",
                                       {},
                                       0,
                                       0,
                                       "volatile transient_local system_default best_available"};

// The part of a message to print.
inline constexpr Option field{"--field", "print only this part: pose.position.x, points[2]",
                              Kind::text, "PLACE"};
inline constexpr Option csv{"--csv",
                            "print the values of a message on one line, separated by commas"};
inline constexpr Option raw{"--raw", "print the bytes of the message object in hexadecimal"};
inline constexpr Option no_arr{"--no-arr", "print only type and length of arrays"};
inline constexpr Option no_str{"--no-str", "print only the length of strings"};
inline constexpr Option full_length{"-f,--full-length", "print arrays and strings in full"};
inline constexpr Option truncate_length{
    "-l,--truncate-length",
    "print at most COUNT elements or characters; without it JSON is complete", Kind::whole, "COUNT",
    "128"};
inline constexpr Option filter{"--filter",
                               "print only messages for which this is true: 'm.data > 3 and m.ok'",
                               Kind::text, "EXPRESSION"};
inline constexpr Option message_info{"-i,--include-message-info",
                                     "also print time stamps and sequence numbers"};

// When to end.
inline constexpr Option once_echo{"--once", "end after the first message"};
inline constexpr Option message_count{
    "-n,--number", "end after COUNT messages", Kind::whole, "COUNT", {}, 1};
inline constexpr Option timeout{"--timeout",
                                "end after SECONDS, with status 124 if too few messages arrived",
                                Kind::real, "SECONDS"};

// Publishing and calling.
inline constexpr Option once_pub{"-1,--once", "publish one message and end"};
inline constexpr Option rate{"-r,--rate", "messages a second", Kind::real, "RATE", "1", 0, 1e6};
inline constexpr Option call_rate{
    "-r,--rate", "call repeatedly, RATE times a second", Kind::real, "RATE", {}, 0, 1e6};
inline constexpr Option times{
    "-t,--times", "end after COUNT messages", Kind::whole, "COUNT", {}, 1};
inline constexpr Option wait_matching{
    "-w,--wait-matching-subscriptions",
    "wait for COUNT subscriptions; default: 1 with --once or --times, else 0", Kind::whole,
    "COUNT"};
inline constexpr Option max_wait{"--max-wait-time-secs",
                                 "wait at most SECONDS for them, then end with status 124",
                                 Kind::real, "SECONDS"};
inline constexpr Option keep_alive{"--keep-alive",
                                   "stay connected for SECONDS after the last message", Kind::real,
                                   "SECONDS", "0.1"};
inline constexpr Option print_each{"-p,--print", "print every N-th message; 0: none", Kind::whole,
                                   "N", "1"};
inline constexpr Option from_stdin{"--stdin", "read the values from standard input"};
inline constexpr Option yaml_file{
    "--yaml-file", "publish each document of this file as a message, in order", Kind::text, "FILE"};
inline constexpr Option node_name{"--node-name", "the name of the node", Kind::text, "NAME"};

}  // namespace options

namespace subjects {

inline constexpr Subject optional_type{"TYPE", "such as std_msgs/msg/String; default: the topic's",
                                       Names::types, Subject::Count::optional};
inline constexpr Subject values{"VALUES",
                                "YAML: '{data: hello}'; default: a message of default values",
                                Names::none, Subject::Count::optional};

}  // namespace subjects

}  // namespace agnocast::ctl
