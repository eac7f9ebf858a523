// SPDX-License-Identifier: Apache-2.0
//
// Goal: `topic echo`, `topic pub` and `topic delay` interoperate with typed nodes in both
// directions, in ros2's formats, with the promised exit statuses, and they end cleanly however
// they are ended. Method: the real daemon, typed and generic endpoints in this process,
// agnocast-ctl as a program of its own.

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/steered_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>
#include <std_msgs/msg/u_int64.hpp>

#include <signal.h>
#include <time.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <regex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using sensor_msgs::msg::PointCloud2;
using std_msgs::msg::String;
using test::CtlResult;
using test::eventually;
using test::PlainNode;
using test::SteeredProcess;
using test::take_soon;
using testing::AllOf;
using testing::HasSubstr;
using testing::MatchesRegex;
using testing::StartsWith;

struct Impostor {
  std::uint64_t number = 0;
};

}  // namespace

template <>
struct MessageTraits<Impostor> {
  static constexpr const char* name = "std_msgs/msg/String";
};

namespace {

class CtlTopic : public test::SuiteDaemon {
 protected:
  static CtlResult ctl(std::vector<std::string> words) {
    return test::run_ctl(daemon->socket_path(), std::move(words));
  }
  /// Returns pub's output, whether or not it had to wait for the subscription.
  static std::string without_waiting(std::string out) {
    const std::string line = "Waiting for at least 1 matching subscription(s)...\n";
    for (; out.starts_with(line); out.erase(0, line.size())) {
    }
    return out;
  }
  static std::vector<std::string> command(std::vector<std::string> words) {
    words.insert(words.begin(), AGNOCAST_TEST_CTL);
    return words;
  }
  template <class T>
  static typename Publisher<T>::SharedPtr latched(const std::string& topic, const T& message) {
    auto publisher = create_publisher<T>(PlainNode(), topic, QoS(5).transient_local());
    publish(*publisher, message);
    return publisher;
  }
  template <class T>
  static void publish(Publisher<T>& publisher, const T& message) {
    auto loan = publisher.borrow_loaned_message();
    *loan = message;
    EXPECT_TRUE(publisher.publish(std::move(loan)));
  }
  static String text(const std::string& data) {
    String message;
    message.data = data;
    return message;
  }
  PlainNode node;
};

PointCloud2 cloud() {
  PointCloud2 cloud;
  cloud.header.frame_id = "top";
  cloud.header.stamp.sec = 5;
  cloud.fields.resize(1);
  cloud.fields[0].name = "x";
  cloud.data.assign(200, 7);
  return cloud;
}

TEST_F(CtlTopic, EchoPrintsTheMessagesOfATypedNode) {
  const auto publisher = latched("/echoed", cloud());
  std::string whole =
      "header:\n  stamp:\n    sec: 5\n    nanosec: 0\n  frame_id: top\nheight: 0\nwidth: 0\n"
      "fields:\n- name: x\n  offset: 0\n  datatype: 0\n  count: 0\nis_bigendian: false\n"
      "point_step: 0\nrow_step: 0\ndata:\n";
  std::string cut = whole;
  for (int i = 0; i < 128; ++i) cut += "- 7\n";
  for (int i = 0; i < 200; ++i) whole += "- 7\n";
  cut += "- '...'\nis_dense: false\n---\n";
  whole += "is_dense: false\n---\n";
  const auto echo = [&](std::vector<std::string> more) {
    std::vector<std::string> words{"topic", "echo", "echoed", "--once", "--timeout", "20"};
    words.insert(words.end(), more.begin(), more.end());
    const CtlResult result = ctl(words);
    EXPECT_EQ(result.status, 0) << result.err;
    EXPECT_EQ(result.err, "");
    return result.out;
  };
  EXPECT_EQ(echo({}), cut) << "echo requests transient local, because the publisher offers it";
  EXPECT_EQ(echo({"--full-length"}), whole);
  EXPECT_EQ(echo({"sensor_msgs/PointCloud2", "-f", "--qos-durability", "transient_local"}), whole);
  EXPECT_THAT(echo({"-l", "2"}), HasSubstr("data:\n- 7\n- 7\n- '...'\n"));
  EXPECT_THAT(echo({"--no-arr", "--no-str"}),
              AllOf(HasSubstr("data: '<sequence type: uint8, length: 200>'\n"),
                    HasSubstr("frame_id: '<string length: <3>>'\n")));
  EXPECT_EQ(echo({"--field", "header.stamp"}), "sec: 5\nnanosec: 0\n---\n");
  EXPECT_EQ(echo({"--field", "header.frame_id"}), "top\n---\n");
  EXPECT_EQ(echo({"--field", "fields[0].name", "--csv"}), "x\n");
  EXPECT_THAT(echo({"--csv", "--no-arr"}), StartsWith("5,0,top,0,0,<sequence"));
  EXPECT_EQ(echo({"--filter", "m.header.frame_id == 'top' and len(m.data) == 200", "-f"}), whole);
  EXPECT_THAT(
      echo({"-i", "--field", "height"}),
      MatchesRegex("publication_sequence_number: 1\nreceived_timestamp: [0-9]+\n"
                   "reception_sequence_number: 1\nsource_timestamp: [0-9]+\n---\n0\n---\n"));
  EXPECT_THAT(echo({"--csv", "-i", "--field", "height"}),
              MatchesRegex("[0-9]{19},[0-9]{19},1,1,0\n"));
  EXPECT_THAT(echo({"--raw", "-l", "1"}), MatchesRegex("[0-9a-f]{2}\n...\n---\n"));
  EXPECT_EQ(std::regex_replace(echo({"--raw", "-f"}), std::regex("[^0-9a-f]"), "").size(),
            2 * sizeof(PointCloud2));
  const auto object = nlohmann::json::parse(echo({"-j"}));
  EXPECT_EQ(object["schema"], "agnocast.topic-echo/1");
  EXPECT_EQ(object["topic"], "/echoed");
  EXPECT_EQ(object["type"], "sensor_msgs/msg/PointCloud2");
  EXPECT_EQ(object["publication_sequence_number"], 1);
  EXPECT_EQ(object["message"]["data"].size(), 200U) << "JSON is whole";
  EXPECT_EQ(nlohmann::json::parse(echo({"-j", "--field", "fields[0].name"}))["field"], "x");
}

TEST_F(CtlTopic, EchoWaitsForATopicOfAGivenTypeAndGoesOn) {
  SteeredProcess echo(command({"topic", "echo", "/later", "std_msgs/msg/String", "-n", "3"}), {});
  auto publisher = create_publisher<String>(node, "/later", QoS(10));
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  publish(*publisher, text("one"));
  EXPECT_EQ(echo.answer(), "data: one");
  EXPECT_EQ(echo.answer(), "---");
  publish(*publisher, text("a\x1b[31m"));
  EXPECT_EQ(echo.answer(), "data: \"a\\e[31m\"");
  publish(*publisher, text("three"));
  publish(*publisher, text("four"));
  EXPECT_EQ(echo.finish(), 0);
  EXPECT_EQ(echo.answer(), "---");
  EXPECT_EQ(echo.answer(), "data: three");
  EXPECT_EQ(echo.answer(), "---");
  EXPECT_EQ(echo.answer(), "(it has ended)");
}

TEST_F(CtlTopic, EchoShowsAUserDefinedClassOnlyAsRawBytes) {
  Impostor message;
  message.number = 0x1122334455667788;
  const auto publisher = latched("/own", message);
  const CtlResult raw = ctl({"topic", "echo", "/own", "--raw", "--once", "--timeout", "20"});
  EXPECT_EQ(raw.out, "8877665544332211\n---\n");
  const CtlResult text = ctl({"topic", "echo", "/own", "--once"});
  EXPECT_EQ(text.status, 1);
  EXPECT_EQ(text.out, "");
  EXPECT_THAT(text.err, AllOf(StartsWith("agnocast-ctl: /own: the topic has another message type, "
                                         "or the same type with another layout: "),
                              HasSubstr("std_msgs/msg/String"), HasSubstr("\nhint: use the type")));
}

TEST_F(CtlTopic, EchoRequestsTheQosThatAllPublishersOffer) {
  auto best_effort = create_publisher<String>(node, "/mixed", QoS(5).best_effort());
  SteeredProcess echo(command({"topic", "echo", "/mixed", "--once"}), {});
  ASSERT_TRUE(eventually([&] { return best_effort->get_linked_subscription_count() == 1; }));
  publish(*best_effort, text("x"));
  EXPECT_EQ(echo.answer(), "data: x");
  EXPECT_EQ(echo.finish(), 0);
  auto reliable = create_publisher<String>(node, "/mixed", QoS(5).transient_local());
  const CtlResult noted = ctl({"topic", "echo", "/mixed", "--timeout", "0.2"});
  EXPECT_EQ(noted.status, 124);
  EXPECT_EQ(
      noted.err,
      "agnocast-ctl: some publishers are reliable and some best effort; using best effort for "
      "all; some publishers are transient local and some volatile; using volatile for all\n"
      "agnocast-ctl: /mixed: 0 messages arrived within 0.2 s\n"
      "hint: agnocast-ctl topic info -v /mixed\n");
  reliable.reset();
  const CtlResult refused =
      ctl({"topic", "echo", "/mixed", "--timeout", "0.5", "--qos-reliability", "reliable"});
  EXPECT_EQ(refused.status, 124);
  EXPECT_THAT(refused.err, HasSubstr("offers less than requested: reliability\n"));
}

TEST_F(CtlTopic, PubReachesATypedNodeWithoutACopy) {
  auto subscription = create_subscription<PointCloud2>(node, "/published", QoS(10));
  SteeredProcess pub(
      command({"topic", "pub", "/published", "sensor_msgs/msg/PointCloud2",
               "{header: {stamp: now, frame_id: a frame id that is outside the string object}, "
               "fields: [{name: x}], data: [1, 2, 3], is_dense: true}",
               "-r", "50", "--node-name", "typist"}),
      {});
  const auto message = take_soon(subscription);
  ASSERT_TRUE(message);
  EXPECT_EQ(message->header.frame_id, "a frame id that is outside the string object");
  EXPECT_NEAR(static_cast<double>(message->header.stamp.sec), static_cast<double>(::time(nullptr)),
              30);
  EXPECT_EQ(message->fields.at(0).name, "x");
  EXPECT_EQ(message->data, (std::vector<std::uint8_t>{1, 2, 3}));
  EXPECT_TRUE(message->is_dense);
  const auto info = ctl({"topic", "info", "/published", "-j"}).json();
  EXPECT_EQ(info["publishers"][0]["is_zero_copy"], true);
  EXPECT_EQ(info["publishers"][0]["node_name"], "typist");
  EXPECT_EQ(pub.answer(), "publisher: beginning loop");
  EXPECT_THAT(pub.answer(), MatchesRegex("publishing #1: \\{header: \\{stamp: \\{sec: [0-9]+, .*"));
  ::kill(pub.pid(), SIGINT);
  EXPECT_EQ(pub.finish(), 0);
  EXPECT_TRUE(eventually([&] { return subscription->get_linked_publisher_count() == 0; }));
}

TEST_F(CtlTopic, PubSendsTheRequestedNumberOfMessages) {
  auto subscription = create_subscription<String>(node, "/times", QoS(100));
  const auto count = [&] {
    int messages = 0;
    while (subscription->take()) ++messages;
    return messages;
  };
  const CtlResult once = ctl({"topic", "pub", "-1", "times", "std_msgs/String", "data: hi"});
  EXPECT_EQ(once.status, 0) << once.err;
  EXPECT_EQ(without_waiting(once.out), "publisher: beginning loop\npublishing #1: {data: hi}\n\n");
  EXPECT_EQ(take_soon(subscription)->data, "hi");
  EXPECT_EQ(count(), 0);
  const CtlResult five = ctl({"topic", "pub", "-t", "5", "-r", "1000", "-p", "2", "/times",
                              "std_msgs/msg/String", "{data: 'a, b'}"});
  EXPECT_EQ(without_waiting(five.out),
            "publisher: beginning loop\npublishing #2: {data: 'a, b'}\n\n"
            "publishing #4: {data: 'a, b'}\n\n");
  EXPECT_EQ(count(), 5);
  const test::TemporaryDirectory directory;
  std::ofstream(directory.path("messages")) << "data: one\n---\ndata: two\n---\n";
  const CtlResult file = ctl({"topic", "pub", "/times", "std_msgs/msg/String", "--yaml-file",
                              directory.path("messages"), "-r", "1000", "-w", "1", "-p", "0"});
  EXPECT_EQ(without_waiting(file.out), "");
  EXPECT_EQ(take_soon(subscription)->data, "one");
  EXPECT_EQ(take_soon(subscription)->data, "two");
  EXPECT_EQ(count(), 0);
  SteeredProcess typed(
      command({"topic", "pub", "/times", "std_msgs/msg/String", "--stdin", "--once"}), {});
  typed.tell("data: typed");
  EXPECT_EQ(typed.finish(), 0);
  EXPECT_EQ(take_soon(subscription)->data, "typed");
  EXPECT_EQ(ctl({"topic", "pub", "-1", "/times", "std_msgs/msg/String"}).status, 0);
  EXPECT_EQ(take_soon(subscription)->data, "") << "without values the defaults";
  const CtlResult alone =
      ctl({"topic", "pub", "-1", "/nobody", "std_msgs/msg/String", "--max-wait-time-secs", "0.5"});
  EXPECT_EQ(alone.status, 124);
  EXPECT_THAT(alone.out, StartsWith("Waiting for at least 1 matching subscription(s)...\n"));
  EXPECT_EQ(without_waiting(alone.out), "");
  EXPECT_EQ(alone.err,
            "agnocast-ctl: /nobody: 0 matching subscriptions of 1 matched in time\n"
            "hint: agnocast-ctl topic info -v /nobody\n");
}

TEST_F(CtlTopic, PubPublishesTheOutputOfEchoUnchanged) {
  test::RandomMessages random(41, {.has_nan = true, .has_any_text = true});
  const test::TemporaryDirectory directory;
  int number = 0;
  for (const char* const name :
       {"agnocast_test_msgs/msg/Everything", "agnocast_test_msgs/msg/Forest",
        "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu", "std_msgs/msg/ByteMultiArray",
        "std_msgs/msg/Empty", "sensor_msgs/srv/SetCameraInfo_Request"}) {
    const std::string suffix = std::to_string(number++);
    const IntrospectedType type = find_message_type(name);
    auto publisher =
        create_generic_publisher(node, "/from" + suffix, type, QoS(1).transient_local());
    auto subscription = create_generic_subscription(node, "/to" + suffix, type, QoS(5));
    GenericLoan loan = publisher->borrow_loaned_message();
    random.fill(type.members(), loan.get());
    const OwnedGenericMessage sent = type.copy(loan.get());
    ASSERT_TRUE(publisher->publish(std::move(loan)));
    const CtlResult echoed =
        ctl({"topic", "echo", "/from" + suffix, "--once", "-f", "--timeout", "20"});
    ASSERT_EQ(echoed.status, 0) << echoed.err;
    const std::string file = directory.path(suffix);
    std::ofstream(file) << echoed.out;
    const CtlResult again =
        ctl({"topic", "pub", "/to" + suffix, name, "--yaml-file", file, "-w", "1"});
    ASSERT_EQ(again.status, 0) << name << again.err << echoed.out;
    const GenericMessage got = take_soon(subscription);
    ASSERT_TRUE(got) << name;
    std::string where;
    EXPECT_TRUE(test::are_same(type.members(), got.get(), sent.get(), &where))
        << name << " differs at " << where;
  }
}

TEST_F(CtlTopic, DelayShowsTheAgeOfTheStamp) {
  auto publisher = create_publisher<PointCloud2>(node, "/stamped", QoS(10));
  SteeredProcess delay(command({"topic", "delay", "/stamped", "-w", "3"}), {});
  SteeredProcess for_programs(command({"topic", "delay", "/stamped", "-j"}), {});
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 2; }));
  for (int i = 0; i < 5; ++i) {
    PointCloud2 message;
    message.header.stamp.sec = static_cast<std::int32_t>(::time(nullptr) - 1000);
    publish(*publisher, message);
  }
  std::smatch found;
  const std::string average = delay.answer();
  ASSERT_TRUE(std::regex_match(average, found, std::regex("average delay: ([0-9.]+)"))) << average;
  EXPECT_NEAR(std::stod(found[1]), 1000, 60);
  EXPECT_THAT(delay.answer(), MatchesRegex("\tmin: 1?[0-9]{3}.[0-9]{3}s max: 1?[0-9]{3}.[0-9]{3}s "
                                           "std dev: [0-9].[0-9]{5}s window: 3"));
  EXPECT_EQ(delay.answer(), "no new messages");
  ::kill(delay.pid(), SIGINT);
  EXPECT_EQ(delay.finish(), 0);
  const std::string object = for_programs.answer();
  EXPECT_NEAR(nlohmann::json::parse(object)["average_s"].get<double>(), 1000, 60);
  test::judge_json(object);
  ::kill(for_programs.pid(), SIGINT);
  EXPECT_EQ(for_programs.finish(), 0);
  const auto unstamped = latched("/unstamped", text("x"));
  const CtlResult refused = ctl({"topic", "delay", "/unstamped"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_EQ(refused.err,
            "agnocast-ctl: /unstamped: std_msgs/msg/String has no header.stamp\n"
            "hint: agnocast-ctl topic echo -i /unstamped\n");
}

TEST_F(CtlTopic, ASignalEndsThemCleanly) {
  auto publisher = create_publisher<String>(node, "/signalled", QoS(1));
  for (const int signal : {SIGINT, SIGTERM}) {
    SteeredProcess echo(command({"topic", "echo", "/signalled"}), {});
    ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
    ::kill(echo.pid(), signal);
    EXPECT_EQ(echo.finish(), 0);
    EXPECT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 0; }));
  }
  // Still waiting for the topic, or for subscriptions.
  SteeredProcess pub(command({"topic", "pub", "-1", "/lonely", "std_msgs/msg/String"}), {});
  EXPECT_EQ(pub.answer(), "Waiting for at least 1 matching subscription(s)...");
  ::kill(pub.pid(), SIGINT);
  EXPECT_EQ(pub.finish(), 0);
}

TEST_F(CtlTopic, AClosedPipeEndsThemWithoutNoise) {
  auto publisher = create_publisher<String>(node, "/piped", QoS(1));
  std::atomic<bool> is_over{false};
  std::thread publishing([&] {
    while (!is_over) {
      publish(*publisher, text("x"));
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  });
  const test::TemporaryDirectory directory;
  const std::string errors = directory.path("errors");
  for (const std::string words :
       {"topic echo /piped", "topic pub /piped std_msgs/msg/String -r 100"}) {
    const std::string script = "(" AGNOCAST_TEST_CTL " " + words + " 2>" + errors + "; echo $? >" +
                               directory.path("status") + ") | head -n 1";
    std::FILE* const pipe = ::popen(script.c_str(), "r");
    char line[256] = "";
    EXPECT_NE(std::fgets(line, sizeof line, pipe), nullptr);
    ::pclose(pipe);
    int status = -1;
    EXPECT_TRUE(eventually(
        [&] { return static_cast<bool>(std::ifstream(directory.path("status")) >> status); }));
    EXPECT_EQ(status, 0) << words;
    std::string noise;
    std::getline(std::ifstream(errors), noise, '\0');
    EXPECT_TRUE(noise.empty() || noise.find("arrived faster") != noise.npos) << noise;
    std::filesystem::remove(directory.path("status"));
  }
  is_over = true;
  publishing.join();
}

// Long because it is the table of bad input.
TEST_F(CtlTopic, BadInputIsRefusedInTwoLines) {
  const auto publisher = latched("/refused", cloud());
  struct Case {
    std::vector<std::string> words;
    int status;
    std::string err;
  };
  const std::string type = "sensor_msgs/msg/PointCloud2";
  const std::string fields =
      "hint: the fields of sensor_msgs/msg/PointCloud2: header, height, width, fields, "
      "is_bigendian, point_step, row_step, data, is_dense\n";
  for (const Case& one : {
           Case{{"echo"}, 2, "NAME: is missing\nhint: agnocast-ctl topic echo /chatter\n"},
           Case{{"echo", "/nowhere"},
                4,
                "/nowhere: there is no such topic in domain 0\nhint: agnocast-ctl topic list\n"},
           Case{{"echo", "no name", "std_msgs/msg/String"},
                2,
                "/no name: a name is not a ROS 2 name: "},
           Case{{"echo", "/x", "nowhere_msgs/msg/X"},
                4,
                "nowhere_msgs/msg/X: there is no support for a message type of this name: "
                "nowhere_msgs/msg/X: no libnowhere_msgs__rosidl_typesupport_introspection_cpp.so "
                "in "},
           Case{{"echo", "/x", "std_msgs/msg/Strin"},
                4,
                "std_msgs/msg/Strin: there is no support for a message type of this name: "
                "std_msgs/msg/Strin: libstd_msgs__rosidl_typesupport_introspection_cpp.so has no "
                "such type\nhint: check the spelling, "},
           Case{{"echo", "/x", "../../etc/passwd"},
                2,
                "../../etc/passwd: a name is not a ROS 2 name: '../../etc/passwd' is no message "
                "type; "},
           Case{{"echo", "/refused", "--field", "heador"},
                2,
                "\"heador\": sensor_msgs/msg/PointCloud2 has no field \"heador\"; it has: "},
           Case{{"echo", "/refused", "--field", "data[x]"},
                2,
                "\"data[x]\": '[' needs an index and ']'\n" + fields},
           Case{{"echo", "/refused", "--filter", "m.height = 1"},
                2,
                "--filter: character 10 of \"m.height = 1\": write == for equality\n"},
           Case{{"echo", "/refused", "--raw", "--csv"},
                2,
                "--raw: cannot be combined with --csv, --field and --filter\n"},
           Case{{"echo", "/refused", "--timeout", "0"},
                2,
                "--timeout: \"0\" is not a number above 0\n"},
           Case{{"echo", "/refused", "--qos-reliability", "maybe"},
                2,
                "--qos-reliability: \"maybe\" is unknown; use one of reliable, best_effort, "},
           Case{{"echo", "/refused", "--qos-depth", "0"}, 2, "--qos-depth: "},
           Case{{"echo", "/refused", "-n", "0"}, 2, "--number: "},
           Case{{"echo", "/refused", "std_msgs/msg/String"},
                1,
                "/refused: the topic has another message type, or the same type with another "
                "layout: "},
           Case{{"pub", "/x"}, 2, "TYPE: is missing\n"},
           Case{{"pub", "/x", type, "{height: -1}"},
                1,
                "height: '-1' is out of the range of uint32\nhint: "},
           Case{{"pub", "/x", type, "{header: {stamp: {sec: soon}}}"},
                1,
                "header.stamp.sec: 'soon' is not of type int32\nhint: "},
           Case{{"pub", "/x", type, "{heigth: 1}"},
                1,
                "sensor_msgs/msg/PointCloud2: sensor_msgs/msg/PointCloud2 has no field 'heigth'; "},
           Case{{"pub", "/x", type, "{height: "}, 1, "YAML: line 1, column "},
           Case{{"pub", "/x", type, "{}", "--stdin"},
                2,
                "VALUES: use only one of VALUES, --stdin and --yaml-file\n"},
           Case{{"pub", "/x", type, "--yaml-file", "/nowhere"},
                1,
                "/nowhere: the operating system refused an operation: opening: No such file or "
                "directory\n"},
           Case{{"pub", "/x", type, "--once", "--times", "3"},
                2,
                "--once: cannot be combined with --times\n"},
           Case{{"pub", "/x", type, "--rate", "0"}, 2, "--rate: \"0\" is not a number above 0"},
           Case{{"pub", "/x", type, "--max-wait-time-secs", "1"},
                2,
                "--max-wait-time-secs: needs --once, "},
           Case{{"pub", "/x", type, "--node-name", "a/b"}, 2, "a/b: a name is not a ROS 2 name: "},
           Case{{"pub", "/refused", "std_msgs/msg/String", "-1"},
                1,
                "/refused: the topic has another message type, or the same type with another "
                "layout: "},
           Case{{"delay"}, 2, "NAME: is missing\n"},
           Case{{"delay", "/refused", "-w", "0"}, 2, "--window: "},
       }) {
    std::vector<std::string> words{"topic"};
    words.insert(words.end(), one.words.begin(), one.words.end());
    const CtlResult result = ctl(words);
    std::string shown;
    for (const std::string& word : words) shown += word + ' ';
    EXPECT_EQ(result.status, one.status) << shown << result.err;
    EXPECT_EQ(result.out, "") << shown;
    EXPECT_THAT(result.err, StartsWith("agnocast-ctl: " + one.err)) << shown;
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 2) << shown << result.err;
    EXPECT_THAT(result.err, HasSubstr("\nhint: ")) << shown;
  }
  const CtlResult nobody =
      test::run_ctl("/nowhere.sock", {"topic", "echo", "/x", "std_msgs/String"});
  EXPECT_EQ(nobody.status, 3) << nobody.err;
  EXPECT_EQ(test::run_ctl("/nowhere.sock", {"topic", "pub", "-1", "/x", "std_msgs/String"}).status,
            3);
  EXPECT_EQ(test::run_ctl("/nowhere.sock", {"topic", "delay", "/x"}).status, 3);
}

}  // namespace
}  // namespace agnocast
