// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/commands.hpp>
#include <ctl/cli/message_options.hpp>

namespace agnocast::ctl {
namespace {

namespace o = options;
namespace s = subjects;

// clang-format off
constexpr Command table[] = {
    {"status", "", "the daemon, its resources and its limits", {}, {}, show_status,
     "Version, uptime, use of each limit, deaths, recoveries, restarts and refusals, and each user's share.",
     "agnocast-ctl status\nagnocast-ctl status --json=pretty"},
    {"top", "", "the whole system on one screen", {},
     these<o::batch, o::rounds, o::delay, o::sort, o::domain, o::all_domains>, show_top,
     "One row a topic, the worst first: X refused or not matched, L a reader lags, H a message has been held for more than a "
     "second, D a publisher has ended before every subscription read all of it, R running, I idle. Keys: q quits, s selects the next order, f "
     "filters by name, h shows help. It reads counters and costs the publishers nothing.",
     "agnocast-ctl top\nagnocast-ctl top -b -n 1\nagnocast-ctl top -b -j -d 5"},
    {"topic", "list", "the topics of the domain", {},
     these<o::show_types, o::count_topics, o::verbose, o::hidden, o::domain, o::all_domains>, list_topics,
     "One name a line, as ros2 topic list prints them.",
     "agnocast-ctl topic list -t\nagnocast-ctl topics --all-domains\nagnocast-ctl topic list -c"},
    {"topic", "info", "the publishers and subscriptions of a topic, and their cost", about<s::topic>,
     these<o::verbose, o::domain>, show_topic,
     "Type and number of publishers and subscriptions; with -v each of them, with its QoS, its process, its counters, and "
     "whether its messages are zero-copy.",
     "agnocast-ctl topic info -v /points\nagnocast-ctl topic info /points --json=short"},
    {"topic", "find", "the topics of a type", about<s::type>,
     these<o::count_topics, o::hidden, o::domain, o::all_domains>, find_topics,
     "Names of the topics whose messages have this type.",
     "agnocast-ctl topic find sensor_msgs/msg/PointCloud2"},
    {"topic", "type", "the type of a topic", about<s::topic>, these<o::domain>, show_type,
     "The type of the topic's messages, as ros2 topic type prints it.",
     "agnocast-ctl topic type /points"},
    {"topic", "hz", "the rate at which topics are published", about<s::topics>,
     these<o::window, o::reports, o::domain>, measure_rate,
     "The rate over the last messages, once a second, with the shortest and the longest gap. Read from counters: the command "
     "does not subscribe, so it costs the publisher nothing.",
     "agnocast-ctl topic hz /points\nagnocast-ctl topic hz -w 100 /points /imu"},
    {"topic", "bw", "the bytes a second that are published", about<s::topics>,
     these<o::bandwidth_window, o::reports, o::domain>, measure_bandwidth,
     "Bytes a second over the last messages, once a second, and the size of the messages: everything that a reader may access, "
     "including the data of containers. Read from counters: the command does not subscribe.",
     "agnocast-ctl topic bw /points\nagnocast-ctl topic bw -j /points /imu"},
    {"topic", "echo", "the messages of a topic, as text", about<s::topic, s::optional_type>,
     these<o::once_echo, o::message_count, o::timeout, o::field, o::filter, o::csv, o::raw,
           o::no_arr, o::no_str, o::full_length, o::truncate_length, o::message_info,
           o::qos_profile, o::qos_depth, o::qos_history, o::qos_reliability, o::qos_durability,
           o::domain>,
     echo_topic,
     "Subscribes and prints each message as ros2 topic echo does. Without TYPE the topic must "
     "exist. The quality of service is one that all publishers offer, unless an option changes it.",
     "agnocast-ctl topic echo /chatter\n"
     "agnocast-ctl topic echo /points --field header.stamp --once\n"
     "agnocast-ctl topic echo /points --no-arr --filter 'm.header.frame_id == \"top\"'"},
    {"topic", "pub", "publish messages written as YAML",
     about<s::topic, s::type, s::values>,
     these<o::once_pub, o::rate, o::times, o::wait_matching, o::max_wait, o::keep_alive,
           o::print_each, o::from_stdin, o::yaml_file, o::node_name, o::qos_profile, o::qos_depth,
           o::qos_history, o::qos_reliability, o::qos_durability, o::domain>,
     pub_topic,
     "Fields that the YAML does not name keep their defaults; `header: auto` and `stamp: now` are the time "
     "of publishing. --yaml-file reads the output of topic echo.",
     "agnocast-ctl topic pub /chatter std_msgs/msg/String '{data: hello}'\n"
     "agnocast-ctl topic pub --once /chatter std_msgs/msg/String --yaml-file message.yaml"},
    {"topic", "delay", "the age of messages on arrival, by the stamp in their header",
     about<s::topic>, these<o::window, o::domain>, show_delay,
     "Average, extremes and standard deviation over a window of messages, every second, as ros2 "
     "topic delay prints them. Waits for the topic to appear.",
     "agnocast-ctl topic delay /points\nagnocast-ctl topic delay /points --window 100"},
    {"service", "list", "the services of the domain", {},
     these<o::show_types, o::count_services, o::hidden_services, o::domain, o::all_domains>, list_services,
     "One name a line, as ros2 service list prints them: services with a server, and services that clients wait for.",
     "agnocast-ctl service list -t\nagnocast-ctl services --all-domains\nagnocast-ctl service list -c"},
    {"service", "info", "the servers and clients of a service", about<s::service>, these<o::verbose, o::domain>, show_service,
     "Type and number of clients and servers; with -v each of them.",
     "agnocast-ctl service info -v /add_two_ints\nagnocast-ctl service info /add_two_ints --json=short"},
    {"service", "find", "the services of a type", about<s::service_type>,
     these<o::count_services, o::hidden_services, o::domain, o::all_domains>, find_services,
     "Names of the services of this type.",
     "agnocast-ctl service find example_interfaces/srv/AddTwoInts"},
    {"service", "type", "the type of a service", about<s::service>, these<o::domain>, show_service_type,
     "The type of the service, as ros2 service type prints it.",
     "agnocast-ctl service type /add_two_ints"},
    {"service", "call", "call a service and print its response",
     about<s::service, s::service_type, s::values>,
     these<o::call_rate, o::timeout, o::from_stdin, o::yaml_file, o::domain>, call_service,
     "Waits for the service, sends the request written as YAML, and waits for the response. Fields that the YAML does not name keep their "
     "defaults; `header: auto` and `stamp: now` are the time of sending. If the server ends before it responds, "
     "the command fails and says so.",
     "agnocast-ctl service call /add_two_ints example_interfaces/srv/AddTwoInts '{a: 2, b: 3}'\n"
     "agnocast-ctl service call /add_two_ints example_interfaces/srv/AddTwoInts '{a: 2, b: 3}' --timeout 5 -j"},
    {"node", "list", "the nodes that publish or subscribe", {},
     these<o::hidden_nodes, o::count_nodes, o::domain, o::every_domain>, list_nodes,
     "One name a line, as ros2 node list prints them. A node without publishers and subscriptions in agnocast "
     "is not listed.",
     "agnocast-ctl node list\nagnocast-ctl nodes -c"},
    {"node", "info", "the publishers, subscriptions, servers and clients of a node", about<s::node>,
     these<o::hidden, o::domain>, show_node,
     "Topics and services with their types, as ros2 node info prints them.",
     "agnocast-ctl node info /lidar/top"},
    {"process", "list", "the processes that publish or subscribe", {},
     these<o::domain, o::all_domains>, list_processes,
     "Each process with its state, its age, the number of its endpoints and heap windows, and the memory of others that it holds.",
     "agnocast-ctl process list\nagnocast-ctl processes --all-domains"},
    {"process", "info", "one process: its endpoints, its heap, its refusals", about<s::named_process>, {},
     show_process,
     "The row of process list, every endpoint, every heap window, and recent refusals.",
     "agnocast-ctl process info 4711\nagnocast-ctl process info lidar"},
    {"process", "revoke", "end the session of a running process", about<s::process>, {}, revoke_process,
     "Other processes then see it as dead: its endpoints end, and messages that it still holds may be overwritten. The process keeps running "
     "but takes no part until it is restarted; the daemon notifies it. Allowed to root, the daemon's user and the owner of the process.",
     "agnocast-ctl process revoke 4711\nagnocast-ctl process revoke 3.17 --json"},
    {"thread", "list", "the threads that run callbacks, and their scheduling", {},
     these<o::verbose, o::domain, o::all_domains>, list_threads,
     "Each thread of an executor with the nodes and callback groups that it runs. Policy, priority or nice value, processors and time on "
     "the processor are what the kernel says now; SET BY is the rule of the daemon's configuration that matches, and, if it is not in force, why. "
     "With -v every callback group.",
     "agnocast-ctl thread list\nagnocast-ctl threads -v --all-domains\nagnocast-ctl threads -j | jq '.threads[] | select(.rule)'"},
    {"heap", "list", "the shared heap windows and their use", {},
     these<o::domain, o::all_domains>, list_heaps,
     "For each heap window of each process: base, length, bytes in use, and the number of messages that begin in it.",
     "agnocast-ctl heap list\nagnocast-ctl heaps --json"},
    {"heap", "info", "the heap windows of one process", about<s::named_process>, {}, show_heap,
     "The rows of heap list for one process.",
     "agnocast-ctl heap info 4711"},
    {"message", "list", "the messages in the queues, their holders, and who has not taken them", about<s::maybe_topic>,
     these<o::domain, o::all_domains>, list_messages,
     "Every message that has a slot in its publisher's queue. When a hold began is not recorded; a message is held for no longer "
     "than its age.",
     "agnocast-ctl message list /points\nagnocast-ctl messages --json"},
    {"monitor", "", "events from now on", {}, these<o::of_topic, o::of_process>, monitor_system,
     "Joins, matches, leaves and deaths, from the daemon's log; lost, copied and refused messages, checked five times a "
     "second. Ctrl-C ends it.",
     "agnocast-ctl monitor\nagnocast-ctl monitor --topic /points --json"},
    {"dump", "", "everything as one JSON object", {}, these<o::watch, o::domain, o::all_domains>, dump_all,
     "The answers of the other commands together, taken at one moment.",
     "agnocast-ctl dump\nagnocast-ctl dump --watch | jq .topics"},
    {"graph", "", "nodes and topics as a picture", {},
     these<o::graph_form, o::hidden, o::domain, o::all_domains>, draw_graph,
     "An edge to a topic is labelled with the rate and the mean size of its messages; a dashed edge from a topic is not zero-copy, and "
     "its label gives the reason.",
     "agnocast-ctl graph | dot -Tsvg > graph.svg\nagnocast-ctl graph --format mermaid"},
    {"metrics", "", "numbers for Prometheus", {},
     these<o::metrics_form, o::output, o::every>, write_metrics,
     "For every domain: the daemon, users, processes, topics and the counters of each endpoint, as Prometheus text or as "
     "OpenMetrics. With --output into a file, for node_exporter's textfile collector; agnocast_up in it is 0 while the daemon "
     "does not answer. Read from counters: the command does not subscribe.",
     "agnocast-ctl metrics\nagnocast-ctl metrics --output agnocast.prom --every 15\nagnocast-ctl metrics --format openmetrics"},
    {"journal", "", "the last operations and recoveries of the daemon", {},
     these<o::records, o::of_topic, o::of_process, o::follow>, show_journal,
     "The newest records of the daemon's redo log, the newest last. They survive restarts of the daemon.",
     "agnocast-ctl journal\nagnocast-ctl journal -n 100 --topic /points\n"
     "agnocast-ctl journal --process lidar --follow\nagnocast-ctl journal --json"},
    {"bridge", "list", "what the bridges carry to and from DDS, and what they cannot", {},
     these<o::verbose, o::bridge_watch, o::bridge_delay, o::domain>, list_bridges,
     "For each agnocast-bridge of the daemon, one row a topic and direction: the number of publishers or remote writers, the number "
     "of endpoints matched on the other side, messages and bytes a second, and messages dropped. One row a service: out is a server "
     "on this host for clients in DDS, in is a server in DDS for clients on this host. Then the topics and services that both sides have and that cannot be bridged, with the reason; with -v also those that exist only on this host, or that a rule excludes.",
     "agnocast-ctl bridge list\nagnocast-ctl bridges --watch --delay 2\nagnocast-ctl bridge list -j | jq .bridges[].unbridged"},
    {"bridge", "info", "one topic or service in DDS: endpoints, QoS, counters, and why it is not bridged", about<s::topic_or_service>,
     these<o::domain>, show_bridged,
     "Each publisher with its writer in DDS, each remote writer with its publisher on this host, and the readers in DDS that serve "
     "subscriptions on this host. For a service: the clients or servers that use the bridge, those on the other side, and the number of "
     "requests and responses.",
     "agnocast-ctl bridge info /points\nagnocast-ctl bridge info /add_two_ints\nagnocast-ctl bridge info /points --domain 7 --json"},
    {"access", "", "the users that may publish and subscribe, and why", about<s::topic>,
     these<o::user, o::domain>, show_access,
     "The rule of the daemon's configuration that decides, the users that it names, and the users that may connect at all; then the permissions "
     "of one user and its use of each quota. The topic need not exist.",
     "agnocast-ctl access /points\nagnocast-ctl access /points --user lidar --json"},
    {"explain", "", "the meaning, cause and remedy of an error code", about<s::code>, {}, explain_code,
     "Every error that a user can see has a code; without CODE the command lists all of them. Needs no daemon.",
     "agnocast-ctl explain hook_missing\nagnocast-ctl explain"},
    {"log-level", "", "show or set the level of agnocastd's log", about<s::level>, {}, show_log_level,
     "Without LEVEL it prints the current level. A change lasts until the daemon ends; only root and the daemon's user may make it.",
     "agnocast-ctl log-level\nagnocast-ctl log-level debug"},
    {"doctor", "", "find what is wrong, and the command that fixes it", {},
     these<o::include_warnings, o::list_checks>, run_doctor,
     "Checks this shell, the way to the daemon, the daemon, its host, and the processes. Each finding has an id, a cause, "
     "and a command that fixes it. Works without a daemon and without root.",
     "agnocast-ctl doctor\nagnocast-ctl doctor -j | jq .checks\nagnocast-ctl doctor --list"},
    {"verify", "", "check every invariant of the running system", {}, {}, verify_system,
     "Checks up to seven times within about two seconds, and reports what every check found broken.",
     "agnocast-ctl verify\nagnocast-ctl verify --json || echo broken"},
};
// clang-format on

}  // namespace

const std::span<const Command> all_commands = table;

}  // namespace agnocast::ctl
