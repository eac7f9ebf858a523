// SPDX-License-Identifier: Apache-2.0
//
// Goal: the examples do what their help says, as separate programs with the preloaded hook, and
// report errors clearly.
// Method: run them as a user would, against the real daemon; check exit status and text.

#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/shell.hpp>

#include <gmock/gmock.h>

#include <cstdlib>
#include <fstream>
#include <future>
#include <string>
#include <vector>

namespace agnocast {
namespace {

using testing::HasSubstr;
using testing::MatchesRegex;

test::ShellResult run(const std::string& command) {
  return test::run_in_shell("timeout 60 " + command + " 2>&1");
}

std::string example(const std::string& name, const test::DaemonProcess& daemon, bool with_hook) {
  return "env AGNOCAST_SOCKET=" + daemon.socket_path() +
         (with_hook ? " LD_PRELOAD=" AGNOCAST_HOOK : "") + " " AGNOCAST_EXAMPLES "/" + name;
}

TEST(Examples, EveryCloudArrivesIntactAtTwoSubscribers) {
  test::DaemonProcess daemon({.config = "", .uid = {}, .arguments = {"--log-level", "debug"}});
  const auto subscribe = [&] {
    return run(example("cloud_subscriber", daemon, false) + " --count 40 --depth 50");
  };
  auto first = std::async(std::launch::async, subscribe);
  ASSERT_TRUE(daemon.wait_for_log("client=0 pid="));
  auto second = std::async(std::launch::async, subscribe);
  ASSERT_TRUE(
      daemon.wait_for_log("endpoint created kind=subscription topic=/points "
                          "type=sensor_msgs/msg/PointCloud2 client=1"));
  const test::ShellResult published = run(example("cloud_publisher", daemon, true) +
                                          " --count 40 --rate 200 --points 20000 --verbose");
  EXPECT_EQ(published.status, 0) << published.text;
  EXPECT_THAT(published.text, HasSubstr("published 40: 400000 bytes, 0 adopted"));
  for (auto* subscriber : {&first, &second}) {
    const test::ShellResult received = subscriber->get();
    EXPECT_EQ(received.status, 0) << received.text;
    EXPECT_THAT(received.text, HasSubstr("40 received, 0 wrong, 0 lost"));
  }
}

/// Publishes `published`, and a subscriber that expects `expected` checks three clouds of it.
test::ShellResult replay(const std::string& published, const std::string& expected) {
  test::DaemonProcess daemon({.config = "", .uid = {}, .arguments = {"--log-level", "debug"}});
  auto subscriber = std::async(std::launch::async, [&] {
    return run(example("cloud_subscriber", daemon, false) + " --count 3 --scan " + expected);
  });
  EXPECT_TRUE(daemon.wait_for_log("endpoint created kind=subscription topic=/points"));
  const test::ShellResult publisher = run(example("cloud_publisher", daemon, true) +
                                          " --count 3 --rate 100 --verbose --scan " + published);
  EXPECT_EQ(publisher.status, 0) << publisher.text;
  EXPECT_THAT(publisher.text, HasSubstr("published 3: "));
  EXPECT_THAT(publisher.text, HasSubstr(" bytes, 0 adopted"));
  return subscriber.get();
}

std::string scan_file(const std::string& directory, const char* name, float first) {
  const std::string path = directory + "/" + name;
  std::ofstream file(path, std::ios::binary);
  for (int i = 0; i < 5 * 2001; ++i) {  // no multiple of four
    const float value = first + static_cast<float>(i);
    file.write(reinterpret_cast<const char*>(&value), sizeof value);
  }
  return path;
}

TEST(Examples, AReplayedScanIsComparedWithTheFile) {
  const std::string directory = test::make_directory();
  const std::string scan = scan_file(directory, "scan", 0),
                    other = scan_file(directory, "other", 1);
  const test::ShellResult same = replay(scan, scan);
  EXPECT_EQ(same.status, 0) << same.text;
  EXPECT_THAT(same.text, HasSubstr("3 received, 0 wrong"));
  const test::ShellResult different = replay(scan, other);
  EXPECT_EQ(different.status, 1) << different.text;
  EXPECT_THAT(different.text, HasSubstr("3 received, 3 wrong"));
  test::remove_directory(directory);
}

TEST(Examples, AScanOfKittiHasFourFields) {
  const std::string directory = test::make_directory();
  const auto write = [&](const char* name, std::size_t floats) {
    const std::vector<float> values(floats, 1.5F);
    std::ofstream(directory + "/" + name, std::ios::binary)
        .write(reinterpret_cast<const char*>(values.data()),
               static_cast<std::streamsize>(floats * sizeof(float)));
    return directory + "/" + name;
  };
  const std::string four = write("four", 4 * 2001), either = write("either", 20 * 100),
                    neither = write("neither", 3 * 2001);
  EXPECT_EQ(replay(four, four).status, 0);
  EXPECT_EQ(replay(four, four + " --fields 4").status, 0);
  EXPECT_EQ(replay(either + " --fields 4", either + " --fields 4").status, 0);
  const test::ShellResult other = replay(either + " --fields 4", either + " --fields 5");
  EXPECT_EQ(other.status, 1) << "the same bytes, but other points";
  EXPECT_THAT(other.text, HasSubstr("3 received, 3 wrong"));
  EXPECT_EQ(replay(neither + " --fields 3", neither + " --fields 3").status, 0);

  test::DaemonProcess daemon;
  const auto refused = [&](const std::string& arguments) {
    const test::ShellResult outcome =
        run(example("cloud_publisher", daemon, true) + " --scan " + arguments);
    EXPECT_NE(outcome.status, 0) << arguments;
    return outcome.text;
  };
  EXPECT_THAT(refused(either), HasSubstr("its size fits 4 and 5 float32 per point"));
  EXPECT_THAT(refused(neither), HasSubstr("not a scan of 4 or 5 float32 per point"));
  EXPECT_THAT(refused(four + " --fields 5"), HasSubstr("not a scan of 5 float32 per point"));
  EXPECT_THAT(refused(four + " --fields 6"), HasSubstr("must be 3, 4 or 5"));
  test::remove_directory(directory);
}

TEST(Examples, ARealLidarScanArrivesIntact) {
  const char* const directory = std::getenv("AGNOCAST_DATA_DIR");
  if (directory == nullptr) GTEST_SKIP() << "AGNOCAST_DATA_DIR is not set";
  const std::string scan = std::string(directory) + "/lidar_top_nuscenes.bin";
  const test::ShellResult received = replay(scan + " --fields 5", scan + " --fields 5");
  EXPECT_EQ(received.status, 0) << received.text;
}

#if AGNOCAST_HAS_ADD_TWO_INTS
TEST(Examples, TwoIntsAreAdded) {
  test::DaemonProcess daemon;
  const test::ShellResult both =
      run("sh -c '" + example("add_two_ints_server", daemon, true) + " & server=$!; " +
          example("add_two_ints_client", daemon, true) +
          " -7 49 || exit 8; kill -TERM $server; wait $server || exit 9'");
  EXPECT_EQ(both.status, 0) << both.text;
  EXPECT_THAT(both.text, HasSubstr("Ready to add two ints.\n"));
  EXPECT_THAT(both.text, HasSubstr("Incoming request: a: -7 b: 49, sending back: 42\n"));
  EXPECT_THAT(both.text, HasSubstr("Sum: 42\n"));
}

TEST(Examples, AddTwoIntsPrintsItsUsage) {
  for (const char* name : {"add_two_ints_server", "add_two_ints_client"}) {
    const test::ShellResult help = run(std::string(AGNOCAST_EXAMPLES "/") + name + " --help");
    EXPECT_EQ(help.status, 0) << help.text;
    EXPECT_THAT(help.text, HasSubstr(std::string("usage: ") + name));
  }
  EXPECT_EQ(run(AGNOCAST_EXAMPLES "/add_two_ints_client 2 many").status, 2);
  EXPECT_EQ(run(AGNOCAST_EXAMPLES "/add_two_ints_server now").status, 2);
}
#endif

TEST(Examples, HelpNamesEveryOption) {
  for (const char* name : {"talker", "listener", "cloud_publisher", "cloud_subscriber"}) {
    const test::ShellResult help = run(std::string(AGNOCAST_EXAMPLES "/") + name + " --help");
    EXPECT_EQ(help.status, 0) << name;
    for (const char* option : {"--topic", "--count", "--rate", "--verbose"})
      EXPECT_THAT(help.text, HasSubstr(option)) << name;
  }
}

TEST(Examples, WrongOptionsAreWrongUsage) {
  for (const char* options : {"--bogus 1", "--count", "--count -1", "--count many", "--rate 0",
                              "--rate nan", "--rate -3", "--depth x", "--points 5"}) {
    const test::ShellResult outcome = run(std::string(AGNOCAST_EXAMPLES "/listener ") + options);
    EXPECT_EQ(outcome.status, 2) << options;
    EXPECT_THAT(outcome.text, MatchesRegex("listener: --[a-z]+: [^\n]+\nhint: listener --help\n"))
        << options;
  }
  const test::ShellResult too_many = run(AGNOCAST_EXAMPLES "/cloud_publisher --points 214748365");
  EXPECT_EQ(too_many.status, 2);
  EXPECT_THAT(too_many.text, HasSubstr("--points: a cloud has at most 214748364 points"));
}

TEST(Examples, AnInterruptedSubscriberPrintsItsCounts) {
  for (const std::string signal : {"INT", "TERM"}) {
    test::DaemonProcess daemon({.config = "", .uid = {}, .arguments = {"--log-level", "debug"}});
    const std::string out = daemon.directory() + "/out";
    auto subscriber = std::async(std::launch::async, [&] {
      return run("sh -c '" + example("cloud_subscriber", daemon, false) + " --verbose >" + out +
                 " & child=$!; until grep -q intact " + out + "; do sleep 0.01; done; kill -" +
                 signal + " $child; wait $child; status=$?; tail -n1 " + out + "; exit $status'");
    });
    ASSERT_TRUE(daemon.wait_for_log("endpoint created kind=subscription topic=/points"));
    EXPECT_EQ(run(example("cloud_publisher", daemon, true) + " --count 1 --points 10").status, 0);
    const test::ShellResult received = subscriber.get();
    EXPECT_EQ(received.status, 0) << signal << received.text;
    EXPECT_EQ(received.text, "1 received, 0 wrong, 0 lost\n") << signal;
  }
}

TEST(Examples, AListenerReceivesFromATalker) {
  test::DaemonProcess daemon({.config = "", .uid = {}, .arguments = {"--log-level", "debug"}});
  auto listener = std::async(std::launch::async, [&] {
    return run(example("listener", daemon, false) + " --count 5 --verbose");
  });
  ASSERT_TRUE(daemon.wait_for_log("endpoint created kind=subscription topic=/chatter"));
  EXPECT_EQ(run(example("talker", daemon, true) + " --count 5 --rate 100").status, 0);
  const test::ShellResult heard = listener.get();
  EXPECT_EQ(heard.status, 0) << heard.text;
  EXPECT_THAT(heard.text, HasSubstr("I heard: 'Hello World: 5'"));
  EXPECT_THAT(heard.text, HasSubstr("5 received, 0 wrong"));
}

TEST(Examples, AreRenamedAndRemappedByTheCommandLine) {
  test::DaemonProcess daemon({.config = "", .uid = {}, .arguments = {"--log-level", "debug"}});
  auto listener = std::async(std::launch::async, [&] {
    return run(example("listener", daemon, false) +
               " --count 5 --verbose --ros-args -r chatter:=gossip -r __ns:=/street");
  });
  ASSERT_TRUE(daemon.wait_for_log("endpoint created kind=subscription topic=/street/gossip"));
  EXPECT_EQ(run(example("talker", daemon, true) +
                " --ros-args -r __node:=neighbour -r neighbour:chatter:=/street/gossip"
                " -r other:chatter:=/nowhere -- --count 5 --rate 100")
                .status,
            0);
  const test::ShellResult heard = listener.get();
  EXPECT_EQ(heard.status, 0) << heard.text;
  EXPECT_THAT(heard.text, HasSubstr("5 received, 0 wrong"));
  const test::ShellResult bad_rule =
      run(example("talker", daemon, true) + " --ros-args -r nonsense");
  EXPECT_EQ(bad_rule.status, 1);
  EXPECT_THAT(bad_rule.text, HasSubstr("\"nonsense\": a remap rule is from:=to"));
}

TEST(Examples, NameTheRosArgumentsThatHaveNoEffect) {
  test::DaemonProcess daemon;
  const test::ShellResult said =
      run(example("talker", daemon, true) +
          " --count 1 --ros-args -p rate:=10 --params-file /f.yaml -r a:=b");
  EXPECT_EQ(said.status, 0) << said.text;
  EXPECT_THAT(said.text, HasSubstr("talker: warning: -p rate:=10: this argument has no effect\n"));
  EXPECT_THAT(said.text, HasSubstr("--params-file /f.yaml: this argument has no effect"));
  EXPECT_THAT(said.text, testing::Not(HasSubstr("a:=b")));
}

TEST(Examples, NameTheirErrors) {
  test::DaemonProcess daemon;
  const test::ShellResult no_hook = run(example("talker", daemon, false) + " --count 1");
  EXPECT_EQ(no_hook.status, 0) << "it copies its messages\n" << no_hook.text;
  const test::ShellResult no_daemon =
      run("env AGNOCAST_SOCKET=/nonexistent/socket " AGNOCAST_EXAMPLES "/listener --count 1");
  EXPECT_EQ(no_daemon.status, 1);
  EXPECT_THAT(no_daemon.text, HasSubstr("agnocastd does not answer"));
  const test::ShellResult unknown = run(example("listener", daemon, false) + " --bogus 1");
  EXPECT_EQ(unknown.status, 2);
  EXPECT_THAT(unknown.text, HasSubstr("--bogus: unknown option"));
  const test::ShellResult bad_topic = run(example("listener", daemon, false) + " --topic /a//b");
  EXPECT_EQ(bad_topic.status, 1);
  EXPECT_THAT(bad_topic.text, HasSubstr("a name is not a ROS 2 name"));
  const test::ShellResult bad_scan =
      run(example("cloud_publisher", daemon, true) + " --scan /etc/passwd");
  EXPECT_EQ(bad_scan.status, 1);
  EXPECT_THAT(bad_scan.text, testing::AnyOf(HasSubstr("not a scan of 4 or 5 float32 per point"),
                                            HasSubstr("its size fits 4 and 5")));
  EXPECT_EQ(run(AGNOCAST_EXAMPLES "/talker --help").status, 0);
}

}  // namespace
}  // namespace agnocast
