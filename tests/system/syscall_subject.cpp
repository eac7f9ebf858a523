// SPDX-License-Identifier: Apache-2.0
//
// The process whose system calls syscalls_test.cpp counts, steered line by line. Marks surround
// exactly the counted section.
//
//   pub · sub · callback · pubs
//   publish N BYTES      label 1: borrow and fill, label 2: publish (or label 3, if it grows)
//   take N               label 4: take, label 5: release
//   none                 label 6: take when there is nothing
//   clock                label 7: reading the clock
//   received             the number of the callback's messages

#include <tests/support/machine/syscall_tracer.hpp>
#include <tests/system/specimen.hpp>

#include <agnocast/agnocast.hpp>

#include <time.h>

#include <atomic>
#include <cstdint>
#include <iostream>
#include <optional>
#include <sstream>
#include <string>

namespace agnocast::test {
namespace {

struct Node {
  const char* get_name() const { return "subject"; }
  const char* get_namespace() const { return "/"; }
  const char* get_fully_qualified_name() const { return "/subject"; }
};

class Marked {
 public:
  explicit Marked(std::uint64_t label) { mark_begin(label); }
  ~Marked() { mark_end(); }
  Marked(const Marked&) = delete;
  Marked& operator=(const Marked&) = delete;
};

class Subject {
 public:
  std::string execute(std::istringstream& line) {
    std::string what;
    line >> what;
    if (what == "pub") return publisher_ = create_publisher<Specimen>(node_, "/traced", 1), "ok";
    if (what == "sub")
      return subscription_ = create_subscription<Specimen>(node_, "/traced", QoS(100)), "ok";
    if (what == "callback") {
      executor_.emplace().add_node(node_);
      subscription_ = create_subscription<Specimen>(
          node_, "/traced", QoS(100),
          [this](const ipc_shared_ptr<const Specimen>&) { received_.fetch_add(1); });
      return "ok";
    }
    if (what == "subs") return std::to_string(publisher_->get_linked_subscription_count());
    if (what == "pubs") return std::to_string(subscription_->get_linked_publisher_count());
    if (what == "received") return std::to_string(received_.load());
    if (what == "publish") return publish(line);
    if (what == "take") return take(line);
    if (what == "none") return take_nothing();
    if (what == "clock") {
      const Marked mark(7);
      timespec now{};
      ::clock_gettime(CLOCK_MONOTONIC, &now);
      return "ok";
    }
    return "unknown " + what;
  }

 private:
  std::string publish(std::istringstream& line) {
    std::uint64_t count = 0, bytes = 0;
    line >> count >> bytes;
    for (std::uint64_t i = 0; i < count; ++i) {
      ipc_shared_ptr<Specimen> loan;
      {
        const Marked mark(bytes == 0 ? 1 : 3);
        loan = publisher_->borrow_loaned_message();
        SpecimenMaker::fill(*loan, 1, {1, next_++ % 8, bytes});
      }
      const Marked mark(bytes == 0 ? 2 : 3);
      if (!publisher_->publish(std::move(loan))) return "not published";
    }
    return "ok";
  }

  std::string take(std::istringstream& line) {
    std::uint64_t count = 0;
    line >> count;
    for (std::uint64_t i = 0; i < count; ++i) {
      ipc_shared_ptr<const Specimen> message;
      {
        const Marked mark(4);
        message = subscription_->take();
      }
      if (!message) return "nothing";
      if (!SpecimenMaker::is_intact(*message, 1, SpecimenMaker::name_of(*message)))
        return "differs";
      const Marked mark(5);
      message.reset();
    }
    return "ok";
  }

  std::string take_nothing() {
    const Marked mark(6);
    return subscription_->take() ? "something" : "ok";
  }

  Node node_;
  std::optional<BackgroundExecutor> executor_;
  std::uint64_t next_ = 0;
  Publisher<Specimen>::SharedPtr publisher_;
  Subscription<Specimen>::SharedPtr subscription_;
  std::atomic<std::uint64_t> received_{0};
};

}  // namespace
}  // namespace agnocast::test

int main() {
  agnocast::test::allow_tracing();
  agnocast::test::Subject subject;
  std::string text;
  while (std::getline(std::cin, text)) {
    std::istringstream line(text);
    std::string answer;
    try {
      answer = subject.execute(line);
    } catch (const std::exception& error) {
      answer = error.what();
    }
    std::cout << answer << std::endl;
  }
  return 0;
}
