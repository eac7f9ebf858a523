// SPDX-License-Identifier: Apache-2.0
//
// An honest relay for the hostile tests: reads texts of all users, and would pass them on. It also
// reads a secret stream, so that memory of one is mapped in it.
//
//   relay_node UID      becomes that user first
//   then line by line on its standard input, each answered with one line:
//     read TOPIC      → ok     a subscription to a stream of Numbered
//     relay TOPIC     → ok     a subscription to std_msgs/msg/String, which makes checked copies
//     forward TOPIC TO → ok    a typed one, whose messages it publishes on TO
//     forward_checked TOPIC TO → ok    the same with checked copies
//     tell TOPIC TEXT → ok     publishes TEXT as std_msgs/msg/String repeatedly; else nothing
//     matched         → how many subscriptions match that publisher
//     state           → read relayed refused strange   strange: texts with another letter than 'h'

#include <agnocast/agnocast.hpp>
#include <agnocast/relay.hpp>
#include <tests/hostile/messages.hpp>
#include <tests/hostile/steered_main.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>

#include <std_msgs/msg/string.hpp>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <sstream>
#include <string>
#include <thread>
#include <utility>

namespace agnocast::test {
namespace {

class RelayNode {
  using Text = std_msgs::msg::String;

 public:
  std::string execute(std::istringstream& line) {
    std::string what, topic;
    line >> what >> topic;
    if (what == "read") {
      secret_ = create_subscription<Numbered>(node_, topic, QoS(10),
                                              [this](ipc_shared_ptr<const Numbered>) { ++read_; });
      return "ok";
    }
    if (what == "relay") {
      rumor_ =
          create_generic_subscription(node_, topic, "std_msgs/msg/String", QoS(100),
                                      [this](const GenericMessage& message) { pass_on(message); });
      return "ok";
    }
    if (what == "forward" || what == "forward_checked") {
      std::string to;
      line >> to;
      const bool checked = what == "forward_checked";
      forwarder_ = create_publisher<Text>(node_, to, QoS(10));
      forwarded_ = create_subscription<Text>(
          node_, topic, QoS(100), [this, checked](const ipc_shared_ptr<const Text>& text) {
            checked ? forward_checked(text) : forward(text);
          });
      return "ok";
    }
    if (what == "tell") {
      publisher_ = create_generic_publisher(node_, topic, "std_msgs/msg/String", QoS(10));
      std::string text;
      if (line >> text) std::thread([this, text] { tell(text); }).detach();
      return "ok";
    }
    if (what == "matched") return std::to_string(publisher_->get_linked_subscription_count());
    if (what == "state")
      return std::to_string(read_) + ' ' + std::to_string(relayed_) + ' ' +
             std::to_string(refused_) + ' ' + std::to_string(strange_);
    return "unknown " + what;
  }

 private:
  [[noreturn]] void tell(const std::string& text) {
    for (;;) {
      auto loan = publisher_->borrow_loaned_message();
      *static_cast<std::string*>(loan.get()) = text;
      static_cast<void>(publisher_->publish(std::move(loan)));
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  }
  void forward(const ipc_shared_ptr<const Text>& message) {
    const PublishResult result = forwarder_->publish(*message);
    if (result) ++relayed_;
    if (result.code == Errc::protocol_violation) ++refused_;
  }
  void forward_checked(const ipc_shared_ptr<const Text>& message) {
    auto copy = try_copy_checked(message);
    if (!copy) {
      ++refused_;
    } else if (forwarder_->publish(std::move(*copy))) {
      ++relayed_;
    }
  }
  void pass_on(const GenericMessage& message) {
    const auto copy = try_copy_checked(message);
    if (!copy) {
      ++refused_;
      return;
    }
    const auto& text = *reinterpret_cast<const std::string*>(copy->get());
    ++relayed_;
    if (text.find_first_not_of('h') != std::string::npos) ++strange_;
  }

  Spun<PlainNode> node_;
  std::atomic<std::uint64_t> read_{0}, relayed_{0}, refused_{0}, strange_{0};
  Subscription<Numbered>::SharedPtr secret_;
  GenericSubscription::SharedPtr rumor_;
  GenericPublisher::SharedPtr publisher_;
  Publisher<Text>::SharedPtr forwarder_;
  Subscription<Text>::SharedPtr forwarded_;
};

}  // namespace
}  // namespace agnocast::test

int main(int argc, char** argv) {
  return agnocast::test::steered_main<agnocast::test::RelayNode>(argc, argv);
}
