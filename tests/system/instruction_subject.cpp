// SPDX-License-Identifier: Apache-2.0
//
// The subject that instruction_test.cpp counts under callgrind: the public interface on a warm
// heap, with the real daemon and the real heap hook. Collection is on only around each counted
// call, in this thread alone; after its rounds a dump with the name of the case is written.

#include <tests/system/sheaf.hpp>

#include <agnocast/agnocast.hpp>

#include <valgrind/callgrind.h>

#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

constexpr int warm_turns = 320, counted_turns = 1024;  // as in instruction_test.cpp
constexpr int batch = 16;                              // both are multiples of it

struct Node {
  const char* get_name() const { return "counted"; }
  const char* get_namespace() const { return "/"; }
  const char* get_fully_qualified_name() const { return "/counted"; }
};

template <class Call>
void counted(bool is_counted, Call call) {
  if (is_counted) CALLGRIND_TOGGLE_COLLECT;
  call();
  if (is_counted) CALLGRIND_TOGGLE_COLLECT;
}

class Counting {
 public:
  explicit Counting(std::size_t subscriptions)
      : topic_("/counted" + std::to_string(subscriptions)),
        publisher_(create_publisher<Sheaf>(node_, topic_, QoS(1))) {
    for (std::size_t i = 0; i < subscriptions; ++i)
      subscriptions_.push_back(create_subscription<Sheaf>(node_, topic_, QoS(batch)));
    while (publisher_->get_linked_subscription_count() < subscriptions) ::usleep(1000);
    for (const auto& subscription : subscriptions_) {
      while (subscription->get_linked_publisher_count() < 1) ::usleep(1000);
    }
  }

  enum class What { borrow, publish, take, release, take_nothing };
  void count(What what, const std::string& name) {
    for (int turn = 0; turn < warm_turns + counted_turns; ++turn) {
      const bool on = turn >= warm_turns;
      ipc_shared_ptr<Sheaf> loan;
      counted(on && what == What::borrow, [&] { loan = publisher_->borrow_loaned_message(); });
      fill(*loan, 2000);  // always the same sizes
      counted(on && what == What::publish, [&] { (void)publisher_->publish(std::move(loan)); });
      for (const auto& subscription : subscriptions_) {
        ipc_shared_ptr<const Sheaf> message;
        counted(on && what == What::take, [&] { message = subscription->take(); });
        counted(on && what == What::release, [&] { message.reset(); });
        counted(on && what == What::take_nothing, [&] { (void)subscription->take(); });
      }
    }
    CALLGRIND_DUMP_STATS_AT(name.c_str());
  }

  /// take_batch of one subscription; each message counts as one round.
  void count_batches(const std::string& name) {
    for (int turn = 0; turn < warm_turns + counted_turns; turn += batch) {
      for (int i = 0; i < batch; ++i) {
        auto loan = publisher_->borrow_loaned_message();
        fill(*loan, 2000);
        (void)publisher_->publish(std::move(loan));
      }
      ipc_shared_ptr<const Sheaf> messages[batch];
      std::size_t taken = 0;
      counted(turn >= warm_turns, [&] { taken = subscriptions_[0]->take_batch(messages, batch); });
      if (taken != batch) throw std::runtime_error("not everything was taken");
    }
    CALLGRIND_DUMP_STATS_AT(name.c_str());
  }

 private:
  Node node_;
  std::string topic_;
  Publisher<Sheaf>::SharedPtr publisher_;
  std::vector<Subscription<Sheaf>::SharedPtr> subscriptions_;
};

}  // namespace
}  // namespace agnocast::test

int main() {
  using agnocast::test::Counting;
  using What = Counting::What;
  try {
    Counting alone(0), one(1), many(16);
    alone.count(What::borrow, "borrow");
    alone.count(What::publish, "publish_to_0");
    one.count(What::publish, "publish_to_1");
    many.count(What::publish, "publish_to_16");
    one.count(What::take, "take");
    one.count(What::release, "release");
    one.count(What::take_nothing, "take_nothing");
    one.count_batches("take_batch_16");
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
