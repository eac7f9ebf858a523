// SPDX-License-Identifier: Apache-2.0
//
// A component as containers load them: contains its message type, and so the code that destroys
// its messages.

#include "plugin.hpp"

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <unistd.h>

#include <memory>
#include <utility>
#include <vector>

namespace {

std::atomic<int>* destroyed_count = nullptr;

struct Counted {
  std::vector<int> numbers;
  Counted() = default;
  Counted(const Counted&) = default;
  Counted& operator=(const Counted&) = default;
  ~Counted() {
    if (destroyed_count != nullptr) ++*destroyed_count;
  }
};

}  // namespace

template <>
struct agnocast::MessageTraits<Counted> {
  static constexpr const char* name = "tests/Counted";
  static void for_each_pointer(const Counted& counted, PointerVisitor& visit) noexcept {
    visit("numbers", counted.numbers);
  }
};

extern "C" {

__attribute__((visibility("default"))) void* plugin_start(std::atomic<int>* destroyed) {
  destroyed_count = destroyed;
  auto publisher = agnocast::create_publisher<Counted>(agnocast::test::PlainNode(), "counted", 1);
  auto loan = publisher->borrow_loaned_message();
  loan->numbers.assign(1000, 42);
  if (!publisher->publish(std::move(loan))) return nullptr;
  return new agnocast::Publisher<Counted>::SharedPtr(std::move(publisher));
}

__attribute__((visibility("default"))) void plugin_stop(void* publisher) {
  delete static_cast<agnocast::Publisher<Counted>::SharedPtr*>(publisher);
}

__attribute__((visibility("default"))) int plugin_hold(int say_fd, int wait_fd) {
  auto subscription = agnocast::create_subscription<Counted>(agnocast::test::PlainNode(), "counted",
                                                             agnocast::QoS(1));
  char byte = 0;
  if (::write(say_fd, &byte, 1) != 1) return 3;
  auto message = agnocast::test::take_soon(subscription);
  if (!message) return 2;
  if (::write(say_fd, &byte, 1) != 1) return 3;
  if (::read(wait_fd, &byte, 1) != 1) return 4;
  if (message->numbers != std::vector<int>(1000, 42)) return 5;
  message.reset();
  if (::read(wait_fd, &byte, 1) != 0) return 6;  // until the host program has ended
  return 0;
}
}
