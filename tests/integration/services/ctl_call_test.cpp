// SPDX-License-Identifier: Apache-2.0
//
// Goal: `agnocast-ctl service call` calls typed services and prints their responses, in ros2's
// format and as JSON, and its exit status says why there is no response.
// Method: typed services in this process, the real daemon, agnocast-ctl as a program of its own.

#include <agnocast/agnocast.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/spun.hpp>
#include <tests/support/processes/steered_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>
#include <std_srvs/srv/set_bool.hpp>
#include <std_srvs/srv/trigger.hpp>

#include <gmock/gmock.h>
#include <signal.h>

#include <cstdlib>
#include <fstream>
#include <future>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using example_interfaces::srv::AddTwoInts;
using std_srvs::srv::SetBool;
using std_srvs::srv::Trigger;
using test::CtlResult;
using test::eventually;
using testing::HasSubstr;

const std::string add_type = "example_interfaces/srv/AddTwoInts";

class CtlCall : public test::SuiteDaemon {
 protected:
  static CtlResult call(std::vector<std::string> words) {
    words.insert(words.begin(), {"service", "call"});
    return test::run_ctl(daemon->socket_path(), std::move(words));
  }
  /// Returns its output, whether or not it had to wait for the service.
  static std::string without_waiting(std::string out) {
    const std::string line = "waiting for service to become available...\n";
    return out.starts_with(line) ? out.substr(line.size()) : out;
  }
  auto serve_sums(const std::string& name) {
    return node.create_service<AddTwoInts>(
        name, [](const ipc_shared_ptr<const AddTwoInts::Request>& request,
                 ipc_shared_ptr<AddTwoInts::Response>& response) {
          response->sum = request->a + request->b;
        });
  }
  test::Spun<Node> node{"server"};
};

TEST_F(CtlCall, PrintsTheResponseOfATypedService) {
  const auto service = serve_sums("/add");
  const CtlResult sum = call({"add", add_type, "{a: 2, b: 40}", "--timeout", "30"});
  EXPECT_EQ(sum.status, 0) << sum.err;
  EXPECT_EQ(sum.err, "");
  EXPECT_EQ(without_waiting(sum.out),
            "requester: making request: {a: 2, b: 40}\n\nresponse:\nsum: 42\n");
  const CtlResult defaults = call({"/add", "example_interfaces/AddTwoInts", "--timeout", "30"});
  EXPECT_EQ(defaults.status, 0) << defaults.err;
  EXPECT_THAT(defaults.out, HasSubstr("{a: 0, b: 0}\n\nresponse:\nsum: 0\n"));
}

TEST_F(CtlCall, PrintsTheSameAsOneJsonObject) {
  const auto service =
      node.create_service<Trigger>("/trigger", [](const ipc_shared_ptr<const Trigger::Request>&,
                                                  ipc_shared_ptr<Trigger::Response>& response) {
        response->success = true;
        response->message = "a message that is too long to be kept inside of its string";
      });
  const CtlResult result = call({"/trigger", "std_srvs/Trigger", "--timeout", "30", "-j"});
  ASSERT_EQ(result.status, 0) << result.err;
  const auto json = result.json();
  EXPECT_EQ(json["schema"], "agnocast.service-call/1");
  EXPECT_EQ(json["service"], "/trigger");
  EXPECT_EQ(json["type"], "std_srvs/srv/Trigger");
  EXPECT_EQ(json["response"]["success"], true);
  EXPECT_EQ(json["response"]["message"],
            "a message that is too long to be kept inside of its string");
}

TEST_F(CtlCall, CallsOnceForEachDocumentOfAFile) {
  const auto service = serve_sums("/file");
  const test::TemporaryDirectory directory;
  const std::string path = directory.path("requests.yaml");
  std::ofstream(path) << "a: 1\nb: 2\n---\n{a: 10, b: 20}\n";
  const CtlResult result = call({"/file", add_type, "--yaml-file", path, "--timeout", "30"});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(without_waiting(result.out),
            "requester: making request: {a: 1, b: 2}\n\nresponse:\nsum: 3\n"
            "requester: making request: {a: 10, b: 20}\n\nresponse:\nsum: 30\n");
  const CtlResult both = call({"/file", add_type, "{}", "--yaml-file", path});
  EXPECT_EQ(both.status, 2);
  EXPECT_THAT(both.err, HasSubstr("hint: agnocast-ctl service call --help\n"));
}

TEST_F(CtlCall, GoesOnAtARateUntilItIsEnded) {
  const auto service = serve_sums("/again");
  test::SteeredProcess again(
      {AGNOCAST_TEST_CTL, "service", "call", "/again", add_type, "{a: 1, b: 2}", "--rate", "50"},
      {});
  int sums = 0;
  for (int line = 0; line < 100 && sums < 5; ++line) sums += again.answer() == "sum: 3" ? 1 : 0;
  EXPECT_EQ(sums, 5);
  ::kill(again.pid(), SIGINT);
  EXPECT_EQ(again.finish(), 0);
}

TEST_F(CtlCall, EndsWhenNoResponseArrivesInTime) {
  const CtlResult nobody = call({"/nobody", add_type, "--timeout", "0.2"});
  EXPECT_EQ(nobody.status, 124);
  EXPECT_EQ(nobody.out, "waiting for service to become available...\n");
  EXPECT_EQ(nobody.err,
            "agnocast-ctl: /nobody: it has no server within 0.2 s\n"
            "hint: agnocast-ctl service info -v /nobody\n");
  const auto silent =
      node.create_service<AddTwoInts>("/silent", [](const ServiceRequest<AddTwoInts>&) {});
  const CtlResult none = call({"/silent", add_type, "--timeout", "3"});
  EXPECT_EQ(none.status, 124);
  EXPECT_THAT(none.err, HasSubstr("/silent: no response came within 3 s\n"));
}

TEST_F(CtlCall, ReportsThatTheServerIsGone) {
  std::promise<void> asked;
  auto service = node.create_service<AddTwoInts>(
      "/gone", [&](const ServiceRequest<AddTwoInts>&) { asked.set_value(); });
  auto calling = std::async(std::launch::async, [&] { return call({"/gone", add_type}); });
  asked.get_future().wait();
  service.reset();
  const CtlResult result = calling.get();
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("/gone: " + std::string(sentence_of(Errc::no_server))));
}

TEST_F(CtlCall, IsEndedByASignalWithAnError) {
  test::SteeredProcess waits({AGNOCAST_TEST_CTL, "service", "call", "/never", add_type}, {});
  EXPECT_EQ(waits.answer(), "waiting for service to become available...");
  ::kill(waits.pid(), SIGINT);
  EXPECT_EQ(waits.finish(), 1);
}

TEST_F(CtlCall, RefusesARequestOfAnotherType) {
  const auto service = serve_sums("/refuses");
  const auto refused = [&](std::vector<std::string> words, int status, const std::string& err) {
    const CtlResult result = call(std::move(words));
    EXPECT_EQ(result.status, status) << result.err;
    EXPECT_THAT(result.err, HasSubstr(err));
  };
  refused({"/refuses"}, 2, "TYPE: is missing\n");
  refused({"/refuses", "nowhere/srv/X"}, 4, "nowhere/srv/X: ");
  refused({"/refuses", add_type, "{c: 1}"}, 1, "'c'");
  refused({"/refuses", add_type, "{a: x}"}, 1, "a: 'x' is not of type int64");
  refused({"/refuses", "std_srvs/srv/SetBool", "{data: true}"}, 1,
          "/refuses: " + std::string(sentence_of(Errc::type_mismatch)));
  refused({"no name", add_type}, 2, "a name is not a ROS 2 name");
}

}  // namespace
}  // namespace agnocast
