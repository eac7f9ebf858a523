// SPDX-License-Identifier: Apache-2.0

#include <ctl/commands.hpp>

namespace agnocast::ctl {
namespace {

namespace o = options;
namespace s = subjects;

constexpr Command table[] = {
    {"status",
     "",
     "the daemon, what it holds and allows",
     {},
     {},
     show_status,
     "Version, uptime, what is in use of which limit, deaths, recoveries, restarts and refusals, "
     "and "
     "each user's share.",
     "agnocast-ctl status\nagnocast-ctl status --json=pretty"},
    {"topic",
     "list",
     "the topics of the domain",
     {},
     these<o::show_types, o::count_topics, o::verbose, o::hidden, o::domain, o::all_domains>,
     list_topics,
     "Names, each on a line, as ros2 topic list prints them.",
     "agnocast-ctl topic list -t\nagnocast-ctl topics --all-domains\nagnocast-ctl topic list -c"},
    {"topic", "info", "who publishes and subscribes there, and what it cost", about<s::topic>,
     these<o::verbose, o::domain>, show_topic,
     "Type, how many publishers and subscriptions; with -v each of them, with its QoS, its process "
     "and "
     "its counters, and whether its messages are really not copied.",
     "agnocast-ctl topic info -v /points\nagnocast-ctl topic info /points --json=short"},
    {"process",
     "list",
     "the processes that publish or subscribe",
     {},
     these<o::domain, o::all_domains>,
     list_processes,
     "Who takes part, in which state, since when, with how many endpoints and windows, and what it "
     "keeps of others' memory.",
     "agnocast-ctl process list\nagnocast-ctl processes --all-domains"},
    {"process",
     "revoke",
     "end the membership of a process that lives",
     about<s::process>,
     {},
     revoke_process,
     "For everybody else the process has died then; it is told, and has to be restarted to take "
     "part "
     "again. Root, the daemon's user and the owner of the process may.",
     "agnocast-ctl process revoke 4711\nagnocast-ctl process revoke 3.17 --json"},
    {"heap",
     "list",
     "the shared heap windows and how far they are in use",
     {},
     these<o::domain, o::all_domains>,
     list_heaps,
     "Of each window of each process: base, length, how far it is in use, and how many messages "
     "begin "
     "in it.",
     "agnocast-ctl heap list\nagnocast-ctl heaps --json"},
    {"journal",
     "",
     "the last operations and recoveries of the daemon",
     {},
     these<o::records, o::of_topic, o::of_process, o::follow>,
     show_journal,
     "The newest records of the daemon's redo log, which stay over its restarts, the newest last.",
     "agnocast-ctl journal\nagnocast-ctl journal -n 100 --topic /points\n"
     "agnocast-ctl journal --process lidar --follow\nagnocast-ctl journal --json"},
    {"verify",
     "",
     "check every invariant of the running system",
     {},
     {},
     verify_system,
     "Looks up to seven times within about two seconds and reports what every look found broken.",
     "agnocast-ctl verify\nagnocast-ctl verify --json || echo broken"},
};

}  // namespace

const std::span<const Command> all_commands = table;

}  // namespace agnocast::ctl
