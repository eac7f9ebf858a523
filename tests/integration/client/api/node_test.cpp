// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast::Node names itself and its topics as ROS 2 does, its endpoints are those of the
// free functions, and callbacks of every promised signature compile and are called.
// Method: the public interface with the real daemon; the test asserts questions of types at
// compile time. The rules themselves: tests/unit/client/node/arguments_test.cpp.

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/messages/error_of.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <cstdlib>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace agnocast {
namespace {

using test::error_of;
using test::eventually;
using test::Number;

// --- accepted callbacks

using Const = ipc_shared_ptr<const Number>;
using Mutable = ipc_shared_ptr<Number>;
template <class Function>
inline constexpr bool is_taken = detail::is_callback<Number, MessageInfo, std::function<Function>>;
static_assert(is_taken<void(Const)> && is_taken<void(const Const&)> && is_taken<void(Const&&)>);
static_assert(is_taken<void(Mutable)> && is_taken<void(const Mutable&)> &&
              is_taken<void(Mutable&&)>);
static_assert(is_taken<void(Const, const MessageInfo&)> && is_taken<void(Const, MessageInfo)> &&
              is_taken<void(const Const&, const MessageInfo&)> &&
              is_taken<void(Const&&, const MessageInfo&)>);
static_assert(is_taken<void(Mutable, const MessageInfo&)> &&
              is_taken<void(Mutable&&, const MessageInfo&)> && is_taken<int(Const)>);
static_assert(is_taken<void(const Number&)> && is_taken<void(std::shared_ptr<const Number>)> &&
              is_taken<void(const Number&, const MessageInfo&)> &&
              is_taken<void(const std::shared_ptr<const Number>&, const MessageInfo&)>);
static_assert(!is_taken<void()> && !is_taken<void(Number&)> && !is_taken<void(Const&)> &&
              !is_taken<void(std::shared_ptr<Number>)> && !is_taken<void(Const, MessageInfo&)> &&
              !is_taken<void(ipc_shared_ptr<const MessageInfo>)>);

class Nodes : public test::SuiteDaemon {
 protected:
  void TearDown() override {
    const char* const none[] = {"program"};
    init(1, none);
  }
};

TEST_F(Nodes, HaveNamesAndResolveThoseOfTopics) {
  Node plain("talker"), inside("talker", "/robot/arm"), relative("talker", "robot");
  EXPECT_STREQ(plain.get_name(), "talker");
  EXPECT_STREQ(plain.get_namespace(), "/");
  EXPECT_STREQ(plain.get_fully_qualified_name(), "/talker");
  EXPECT_STREQ(inside.get_fully_qualified_name(), "/robot/arm/talker");
  EXPECT_STREQ(relative.get_namespace(), "/robot");
  EXPECT_EQ(inside.resolve_topic_name("points"), "/robot/arm/points");
  EXPECT_EQ(inside.resolve_topic_name("~/points"), "/robot/arm/talker/points");
  EXPECT_EQ(inside.resolve_topic_name("/points"), "/points");
}

TEST_F(Nodes, ReportWhereANameIsWrong) {
  EXPECT_THAT(error_of([] { Node node("a b"); }),
              testing::HasSubstr("node name \"a b\": a space is not allowed, at character 2"));
  EXPECT_THAT(error_of([] { Node node("a/b"); }), testing::HasSubstr("at character 2"));
  EXPECT_THAT(error_of([] { Node node("node", "/a//b"); }),
              testing::HasSubstr("namespace \"/a//b\": two slashes in a row, at character 4"));
  EXPECT_THAT(error_of([] { Node node(std::string(200, 'a'), "/" + std::string(100, 'b')); }),
              testing::HasSubstr("longer than 255"));
  Node node("node");
  EXPECT_THAT(error_of([&] { node.resolve_topic_name("2nd"); }),
              testing::HasSubstr("topic \"2nd\": a digit cannot be the first character"));
  EXPECT_THAT(error_of([&] { node.create_publisher<Number>("a-b", 1); }),
              testing::HasSubstr("at character 2"));
  const auto refused = try_create_publisher<Number>(node, "a-b", 1);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::invalid_name);
}

TEST_F(Nodes, ObeyTheirOwnRulesAndThoseOfTheCommandLine) {
  const char* const line[] = {"program",           "own", "--ros-args", "-r", "points:=/all", "-r",
                              "__ns:=/everywhere", "--",  "--also-own"};
  init(9, line);
  EXPECT_THAT(remove_ros_arguments(9, line), testing::ElementsAre("program", "own", "--also-own"));
  Node node("node"),
      other("node", "/here",
            NodeOptions().arguments({"--ros-args", "-r", "points:=mine", "-r", "__node:=renamed"}));
  EXPECT_STREQ(node.get_fully_qualified_name(), "/everywhere/node");
  EXPECT_EQ(node.resolve_topic_name("points"), "/all");
  EXPECT_STREQ(other.get_fully_qualified_name(), "/everywhere/renamed");
  EXPECT_EQ(other.resolve_topic_name("points"), "/everywhere/mine");
  Node apart("node", "/here", NodeOptions().use_global_arguments(false));
  EXPECT_EQ(apart.resolve_topic_name("points"), "/here/points");
  EXPECT_STREQ(node.create_publisher<Number>("points", 1)->get_topic_name(), "/all");
  EXPECT_STREQ(agnocast::create_publisher<Number>(&node, "points", 1)->get_topic_name(), "/all");
}

TEST_F(Nodes, ListTheArgumentsThatHaveNoEffect) {
  const char* const line[] = {"program", "--ros-args", "-p", "rate:=10", "-r", "points:=/all"};
  init(6, line);
  EXPECT_THAT(ignored_ros_arguments(6, line), testing::ElementsAre("-p rate:=10"));
  const NodeOptions own =
      NodeOptions().arguments({"--ros-args", "--params-file", "/f.yaml", "-r", "a:=b"});
  EXPECT_THAT(Node("node", own).ignored_arguments(),
              testing::ElementsAre("--params-file /f.yaml", "-p rate:=10"));
  EXPECT_THAT(Node("node", NodeOptions().use_global_arguments(false)).ignored_arguments(),
              testing::IsEmpty());
  init(1, line);
  EXPECT_THAT(Node("node").ignored_arguments(), testing::IsEmpty());
}

TEST_F(Nodes, WarnOnceAboutArgumentsThatHaveNoEffect) {
  const char* const line[] = {"/opt/bin/program", "--ros-args", "-p", "said_once:=1",
                              "--params-file",    "/said.yaml", "-r", "points:=/all"};
  const auto written_by = [&](int argc, const InitOptions& options) {
    testing::internal::CaptureStderr();
    init(argc, line, options);
    return testing::internal::GetCapturedStderr();
  };
  EXPECT_EQ(written_by(6, InitOptions().warn_of_ignored_arguments(false)), "");
  EXPECT_EQ(written_by(4, InitOptions()),
            "program: warning: -p said_once:=1: this argument has no effect\n");
  EXPECT_EQ(written_by(8, InitOptions()),
            "program: warning: --params-file /said.yaml: this argument has no effect\n");
  EXPECT_EQ(written_by(8, InitOptions()), "");
  EXPECT_EQ(written_by(0, InitOptions()), "");
}

TEST_F(Nodes, RefuseWrongArguments) {
  const auto with = [](std::vector<std::string> arguments) {
    return error_of([&] { Node node("node", NodeOptions().arguments(arguments)); });
  };
  EXPECT_THAT(with({"--ros-args", "-r", "nonsense"}), testing::HasSubstr("\"nonsense\""));
  EXPECT_THAT(with({"--ros-args", "--bogus"}), testing::HasSubstr("\"--bogus\""));
  EXPECT_EQ(with({"--bogus"}), "(no error)") << "not a ROS argument";
}

/// A node as users write them.
class Relay : public Node {
 public:
  Relay() : Node("relay") {
    publisher_ = create_publisher<Number>("out", 10);
    subscription_ = create_subscription<Number>(
        "in", 10, [this](const ipc_shared_ptr<const Number>& number, const MessageInfo& info) {
          auto answer = publisher_->borrow_loaned_message();
          answer->value = number->value * 100 + info.sequence;
          publisher_->publish(std::move(answer));
        });
  }

 private:
  Publisher<Number>::SharedPtr publisher_;
  Subscription<Number>::SharedPtr subscription_;
};

TEST_F(Nodes, MayBeDerivedFromAndUseTheirMembersInCallbacks) {
  Relay relay;
  Node node("asker");
  auto answers = node.create_subscription<Number>("out", 10);
  auto questions = node.create_publisher<Number>("in", 10);
  ASSERT_TRUE(eventually([&] { return answers->get_linked_publisher_count() == 1; }));
  for (std::uint64_t value : {7u, 8u}) {
    auto question = questions->borrow_loaned_message();
    question->value = value;
    ASSERT_TRUE(questions->publish(std::move(question)));
  }
  SingleThreadedExecutor executor;
  executor.add_node(relay);
  std::vector<std::uint64_t> values;
  EXPECT_TRUE(eventually([&] {
    executor.spin_once(std::chrono::milliseconds(1));
    if (auto answer = answers->take()) values.push_back(answer->value);
    return values.size() == 2;
  }));
  EXPECT_THAT(values, testing::ElementsAre(701, 802));
}

TEST_F(Nodes, CallbacksOfEverySignatureAreCalled) {
  Node node("shapes");
  std::vector<std::uint64_t> values;
  std::uint64_t infos = 0;
  const auto note = [&](const auto& number) { values.push_back(number->value); };
  std::vector<Subscription<Number>::SharedPtr> all;
  const auto add = [&](auto callback) {
    all.push_back(node.create_subscription<Number>("shapes", 1, std::move(callback)));
  };
  SingleThreadedExecutor executor;
  executor.add_node(node);
  add([&](Const number) { note(number); });
  add([&](const Const& number) { note(number); });
  add([&](Const&& number) { note(number); });
  add([&](Mutable number) { note(number); });
  add([&](const auto& number) { note(number); });
  add([&](Mutable&& number, const MessageInfo& info) { note(number), infos += info.sequence; });
  add([&](Const number, MessageInfo info) { note(number), infos += info.sequence; });
  add([calls = 0, &note](Const number) mutable { note(number), ++calls; });
  add([&](const Number& number) { values.push_back(number.value); });
  std::shared_ptr<const Number> kept;
  add([&](std::shared_ptr<const Number> number, const MessageInfo& info) {
    note(number), infos += info.sequence, kept = std::move(number);
  });
  auto publisher = node.create_publisher<Number>("shapes", 1);
  auto number = publisher->borrow_loaned_message();
  number->value = 5;
  ASSERT_TRUE(publisher->publish(std::move(number)));
  EXPECT_TRUE(eventually([&] {
    executor.spin_once(std::chrono::milliseconds(1));
    return values.size() == 10;
  }));
  EXPECT_THAT(values, testing::Each(5));
  EXPECT_EQ(infos, 3u);
  all.clear();
  EXPECT_EQ(kept->value, 5u) << "it is held without its subscription";
}

TEST_F(Nodes, APollingSubscriberReturnsTheNewestAndKeepsIt) {
  Node node("polling");
  PollingSubscriber<Number>::SharedPtr subscriber = node.create_subscription<Number>("polled", 5);
  auto publisher = node.create_publisher<Number>("polled", 5);
  EXPECT_TRUE(subscriber->take_data() == nullptr && nullptr == subscriber->take_data());
  for (std::uint64_t value : {1u, 2u, 3u}) {
    auto number = publisher->borrow_loaned_message();
    number->value = value;
    ASSERT_TRUE(publisher->publish(std::move(number)));
  }
  ASSERT_TRUE(eventually([&] { return static_cast<bool>(subscriber->take_data()); }));
  EXPECT_EQ(subscriber->take_data()->value, 3u);
  EXPECT_TRUE(subscriber->take_data() != nullptr && nullptr != subscriber->take_data());
  EXPECT_EQ(subscriber->takeData()->value, 3u) << "the same message again";
  EXPECT_EQ(subscriber->get_lost_count(), 0u);
}

}  // namespace
}  // namespace agnocast
