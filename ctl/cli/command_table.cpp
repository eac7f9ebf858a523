// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/commands.hpp>
#include <ctl/cli/message_options.hpp>

namespace agnocast::ctl {
namespace {

namespace o = options;
namespace s = subjects;

// clang-format off
constexpr Command table[] = {
    {"status", "", "the daemon, what it holds and allows", {}, {}, show_status,
     "Version, uptime, what is in use of which limit, deaths, recoveries, restarts and refusals, and each user's share.",
     "agnocast-ctl status\nagnocast-ctl status --json=pretty"},
    {"top", "", "the whole system on one screen", {},
     these<o::batch, o::rounds, o::delay, o::sort, o::domain, o::all_domains>, show_top,
     "One row a topic, what hurts first: X refused or not matched, L a reader lags, H a message is held for more than a "
     "second, D a publisher is gone and not read to its end, R running, I idle. Keys: q ends, s takes the next order, f "
     "filters by name, h explains. Looks at counters and costs the publishers nothing.",
     "agnocast-ctl top\nagnocast-ctl top -b -n 1\nagnocast-ctl top -b -j -d 5"},
    {"topic", "list", "the topics of the domain", {},
     these<o::show_types, o::count_topics, o::verbose, o::hidden, o::domain, o::all_domains>, list_topics,
     "Names, each on a line, as ros2 topic list prints them.",
     "agnocast-ctl topic list -t\nagnocast-ctl topics --all-domains\nagnocast-ctl topic list -c"},
    {"topic", "info", "who publishes and subscribes there, and what it cost", about<s::topic>,
     these<o::verbose, o::domain>, show_topic,
     "Type, how many publishers and subscriptions; with -v each of them, with its QoS, its process and its counters, and "
     "whether its messages are really not copied.",
     "agnocast-ctl topic info -v /points\nagnocast-ctl topic info /points --json=short"},
    {"topic", "find", "the topics of a type", about<s::type>,
     these<o::count_topics, o::hidden, o::domain, o::all_domains>, find_topics,
     "Names of the topics whose messages have this type.",
     "agnocast-ctl topic find sensor_msgs/msg/PointCloud2"},
    {"topic", "type", "the type of a topic", about<s::topic>, these<o::domain>, show_type,
     "The type of its messages, as ros2 topic type prints it.",
     "agnocast-ctl topic type /points"},
    {"topic", "hz", "how often something is published", about<s::topics>,
     these<o::window, o::reports, o::domain>, measure_rate,
     "The rate over the last messages, once a second, with the shortest and the longest gap. Read from counters: nothing "
     "subscribes, so it costs the publisher nothing.",
     "agnocast-ctl topic hz /points\nagnocast-ctl topic hz -w 100 /points /imu"},
    {"topic", "bw", "how many bytes are published", about<s::topics>,
     these<o::bandwidth_window, o::reports, o::domain>, measure_bandwidth,
     "Bytes a second over the last messages, once a second, and how large the messages are: what a reader may touch, with "
     "all that they point to. Read from counters: nothing subscribes.",
     "agnocast-ctl topic bw /points\nagnocast-ctl topic bw -j /points /imu"},
    {"topic", "echo", "the messages of a topic, as text", about<s::topic, s::optional_type>,
     these<o::once_echo, o::message_count, o::timeout, o::field, o::filter, o::csv, o::raw,
           o::no_arr, o::no_str, o::full_length, o::truncate_length, o::message_info,
           o::qos_profile, o::qos_depth, o::qos_history, o::qos_reliability, o::qos_durability,
           o::domain>,
     echo_topic,
     "Subscribes and prints each message as ros2 topic echo does. Without a TYPE the topic must be "
     "there. Quality of service is what all publishers offer, unless an option says otherwise.",
     "agnocast-ctl topic echo /chatter\n"
     "agnocast-ctl topic echo /points --field header.stamp --once\n"
     "agnocast-ctl topic echo /points --no-arr --filter 'm.header.frame_id == \"top\"'"},
    {"topic", "pub", "publish messages that are written as YAML",
     about<s::topic, s::type, s::values>,
     these<o::once_pub, o::rate, o::times, o::wait_matching, o::max_wait, o::keep_alive,
           o::print_each, o::from_stdin, o::yaml_file, o::node_name, o::qos_profile, o::qos_depth,
           o::qos_history, o::qos_reliability, o::qos_durability, o::domain>,
     pub_topic,
     "Fields that are not named have their defaults; `header: auto` and `stamp: now` are the time "
     "of publishing. What topic echo prints is read back by --yaml-file.",
     "agnocast-ctl topic pub /chatter std_msgs/msg/String '{data: hello}'\n"
     "agnocast-ctl topic pub --once /chatter std_msgs/msg/String --yaml-file message.yaml"},
    {"topic", "delay", "how old messages are when they arrive, by the stamp in their header",
     about<s::topic>, these<o::window, o::domain>, show_delay,
     "Average, extremes and standard deviation over a window of messages, every second, as ros2 "
     "topic delay prints them. Waits for the topic.",
     "agnocast-ctl topic delay /points\nagnocast-ctl topic delay /points --window 100"},
    {"service", "list", "the services of the domain", {},
     these<o::show_types, o::count_services, o::hidden_services, o::domain, o::all_domains>, list_services,
     "Names, each on a line, as ros2 service list prints them: of what somebody serves, and of what somebody asks in vain.",
     "agnocast-ctl service list -t\nagnocast-ctl services --all-domains\nagnocast-ctl service list -c"},
    {"service", "info", "who serves and who asks", about<s::service>, these<o::verbose, o::domain>, show_service,
     "Type, how many clients and servers; with -v each of them.",
     "agnocast-ctl service info -v /add_two_ints\nagnocast-ctl service info /add_two_ints --json=short"},
    {"service", "find", "the services of a type", about<s::service_type>,
     these<o::count_services, o::hidden_services, o::domain, o::all_domains>, find_services,
     "Names of the services of this type.",
     "agnocast-ctl service find example_interfaces/srv/AddTwoInts"},
    {"service", "type", "the type of a service", about<s::service>, these<o::domain>, show_service_type,
     "Its type, as ros2 service type prints it.",
     "agnocast-ctl service type /add_two_ints"},
    {"service", "call", "ask a service, and print what it answers",
     about<s::service, s::service_type, s::values>,
     these<o::call_rate, o::timeout, o::from_stdin, o::yaml_file, o::domain>, call_service,
     "Waits for the service, sends what is written as YAML, and waits for the response. Fields that are not named have their "
     "defaults; `header: auto` and `stamp: now` are the time of sending. When whoever had the request ends without a "
     "response, that is said.",
     "agnocast-ctl service call /add_two_ints example_interfaces/srv/AddTwoInts '{a: 2, b: 3}'\n"
     "agnocast-ctl service call /add_two_ints example_interfaces/srv/AddTwoInts '{a: 2, b: 3}' --timeout 5 -j"},
    {"node", "list", "the nodes that publish or subscribe", {},
     these<o::hidden_nodes, o::count_nodes, o::domain, o::every_domain>, list_nodes,
     "Names, each on a line, as ros2 node list prints them. A node that has neither a publisher nor a subscription here is "
     "not known here.",
     "agnocast-ctl node list\nagnocast-ctl nodes -c"},
    {"node", "info", "what a node publishes, subscribes, serves and asks", about<s::node>,
     these<o::hidden, o::domain>, show_node,
     "Topics, services and types by side, as ros2 node info prints them.",
     "agnocast-ctl node info /lidar/top"},
    {"process", "list", "the processes that publish or subscribe", {},
     these<o::domain, o::all_domains>, list_processes,
     "Who takes part, in which state, since when, with how many endpoints and windows, and what it keeps of others' memory.",
     "agnocast-ctl process list\nagnocast-ctl processes --all-domains"},
    {"process", "info", "one process: its endpoints, its heap, what it was refused", about<s::named_process>, {},
     show_process,
     "What process list says, and every endpoint, every window and what was refused lately.",
     "agnocast-ctl process info 4711\nagnocast-ctl process info lidar"},
    {"process", "revoke", "end the membership of a process that lives", about<s::process>, {}, revoke_process,
     "For everybody else the process has died then; it is told, and has to be restarted to take part again. Root, the "
     "daemon's user and the owner of the process may.",
     "agnocast-ctl process revoke 4711\nagnocast-ctl process revoke 3.17 --json"},
    {"heap", "list", "the shared heap windows and how far they are in use", {},
     these<o::domain, o::all_domains>, list_heaps,
     "Of each window of each process: base, length, how far it is in use, and how many messages begin in it.",
     "agnocast-ctl heap list\nagnocast-ctl heaps --json"},
    {"heap", "info", "the windows of one process", about<s::named_process>, {}, show_heap,
     "As heap list, of one process.",
     "agnocast-ctl heap info 4711"},
    {"message", "list", "what lies in the queues, who holds it, who has not taken it", about<s::maybe_topic>,
     these<o::domain, o::all_domains>, list_messages,
     "Every message that has a place in its publisher's queue. A hold is no older than the message: when it began is "
     "written down nowhere.",
     "agnocast-ctl message list /points\nagnocast-ctl messages --json"},
    {"monitor", "", "what happens from now on", {}, these<o::of_topic, o::of_process>, monitor_system,
     "Who comes, matches, leaves and dies, from the daemon's log; and what is lost, copied in or refused, five times a "
     "second. Ends with Ctrl-C.",
     "agnocast-ctl monitor\nagnocast-ctl monitor --topic /points --json"},
    {"dump", "", "everything as one JSON object", {}, these<o::watch, o::domain, o::all_domains>, dump_all,
     "What the other commands say, together and of one moment.",
     "agnocast-ctl dump\nagnocast-ctl dump --watch | jq .topics"},
    {"graph", "", "nodes and topics as a picture", {},
     these<o::graph_form, o::hidden, o::domain, o::all_domains>, draw_graph,
     "An edge to a topic carries the rate and the mean size of its messages; an edge from a topic is dashed when what comes "
     "over it is not zero-copy, with the reason.",
     "agnocast-ctl graph | dot -Tsvg > graph.svg\nagnocast-ctl graph --format mermaid"},
    {"metrics", "", "numbers for Prometheus", {},
     these<o::metrics_form, o::output, o::every>, write_metrics,
     "Of every domain: the daemon, users, processes, topics, and what each endpoint counts, in Prometheus' text format or in "
     "OpenMetrics. With --output into a file, for node_exporter's textfile collector; agnocast_up is 0 there when the daemon "
     "does not answer. Read from counters: nothing subscribes.",
     "agnocast-ctl metrics\nagnocast-ctl metrics --output agnocast.prom --every 15\nagnocast-ctl metrics --format openmetrics"},
    {"journal", "", "the last operations and recoveries of the daemon", {},
     these<o::records, o::of_topic, o::of_process, o::follow>, show_journal,
     "The newest records of the daemon's redo log, which stay over its restarts, the newest last.",
     "agnocast-ctl journal\nagnocast-ctl journal -n 100 --topic /points\n"
     "agnocast-ctl journal --process lidar --follow\nagnocast-ctl journal --json"},
    {"bridge", "list", "what goes to and from DDS, and what does not", {},
     these<o::verbose, o::bridge_watch, o::bridge_delay, o::domain>, list_bridges,
     "One row for each topic and way of every agnocast-bridge beside the daemon: how many publishers or remote writers, how "
     "many are matched on the other side, messages and bytes a second, and what was dropped. One row for each service: out is a server "
     "of this host for clients in DDS, in is one in DDS for clients of this host. Then what both sides have and cannot be bridged, and why; with -v also what nobody in DDS has, or a rule leaves out.",
     "agnocast-ctl bridge list\nagnocast-ctl bridges --watch --delay 2\nagnocast-ctl bridge list -j | jq .bridges[].unbridged"},
    {"bridge", "info", "one topic or service in DDS: its endpoints, QoS, counters, and why not", about<s::topic_or_service>,
     these<o::domain>, show_bridged,
     "Each publisher with its writer in DDS, each remote writer with its publisher here, and the readers in DDS that serve "
     "subscriptions of this host. Of a service, for whom it goes over the bridge, who is on the other side, and how many "
     "requests and responses went.",
     "agnocast-ctl bridge info /points\nagnocast-ctl bridge info /add_two_ints\nagnocast-ctl bridge info /points --domain 7 --json"},
    {"access", "", "who may publish and subscribe there, and why", about<s::topic>,
     these<o::user, o::domain>, show_access,
     "Which rule of the daemon's configuration decides, whom it names, and who may connect at all; then what one user may, "
     "and how much of each quota it has. There need not be such a topic.",
     "agnocast-ctl access /points\nagnocast-ctl access /points --user lidar --json"},
    {"explain", "", "what a code means, what is behind it, what to do", about<s::code>, {}, explain_code,
     "Every error that a user can see has a code; without one all of them are listed. Needs no daemon.",
     "agnocast-ctl explain hook_missing\nagnocast-ctl explain"},
    {"log-level", "", "what agnocastd logs, and from now on", about<s::level>, {}, show_log_level,
     "Without a word the level in force. A change lasts until the daemon ends; root and the daemon's user may make it.",
     "agnocast-ctl log-level\nagnocast-ctl log-level debug"},
    {"doctor", "", "find what is wrong, and say which command mends it", {},
     these<o::include_warnings, o::list_checks>, run_doctor,
     "Looks at this shell, the way to the daemon, the daemon, its host, and the processes: what is found has an id, a cause, "
     "and a command that mends it. Works without a daemon and without root.",
     "agnocast-ctl doctor\nagnocast-ctl doctor -j | jq .checks\nagnocast-ctl doctor --list"},
    {"verify", "", "check every invariant of the running system", {}, {}, verify_system,
     "Looks up to seven times within about two seconds and reports what every look found broken.",
     "agnocast-ctl verify\nagnocast-ctl verify --json || echo broken"},
};
// clang-format on

}  // namespace

const std::span<const Command> all_commands = table;

}  // namespace agnocast::ctl
