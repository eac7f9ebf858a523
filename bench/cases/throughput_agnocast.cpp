// SPDX-License-Identifier: Apache-2.0
//
// Agnocast in the case throughput. Messages are plain bytes, uninitialised as in iceoryx: the
// case itself writes every byte. The systems differ in the waiting thread:
//
//   agnocast-executor   SingleThreadedExecutor: sleeps if there is nothing
//   agnocast-spin-sleep SpinningExecutor of default budget: polls for a while, then sleeps
//   agnocast-take       take() in a loop that never sleeps
//   agnocast-batch      likewise, but take_batch() of up to 16

#include <bench/cases/throughput.hpp>
#include <bench/services.hpp>

#include <agnocast/agnocast.hpp>

#include <unistd.h>

#include <atomic>
#include <stdexcept>
#include <string>

namespace agnocast::bench::throughput {

struct SmallBytes {
  SmallBytes() noexcept {}
  std::byte bytes[small_bytes];
};
struct LargeBytes {
  LargeBytes() noexcept {}
  std::byte bytes[large_bytes];
};
static_assert(sizeof(SmallBytes) == small_bytes && sizeof(LargeBytes) == large_bytes);

}  // namespace agnocast::bench::throughput

template <>
struct agnocast::MessageTraits<agnocast::bench::throughput::SmallBytes> {
  static constexpr const char* name = "bench/SmallBytes";
};
template <>
struct agnocast::MessageTraits<agnocast::bench::throughput::LargeBytes> {
  static constexpr const char* name = "bench/LargeBytes";
};

namespace agnocast::bench::throughput {
namespace {

std::string node_name(const char* side) {
  return std::string("throughput_") + side + "_" + std::to_string(::getpid());
}

template <class T>
class AgnocastSender final : public Sender {
 public:
  explicit AgnocastSender(const Carriage& carriage)
      : node_(node_name("sender")),
        publisher_(node_.create_publisher<T>(carriage.topic, QoS(carriage.depth))),
        receivers_(carriage.receivers) {}
  bool is_matched() override { return publisher_->get_linked_subscription_count() == receivers_; }
  std::byte* prepare() override {
    if (!loan_) loan_ = publisher_->borrow_loaned_message();
    return loan_->bytes;
  }
  bool send() override { return static_cast<bool>(publisher_->publish(std::move(loan_))); }

 private:
  Node node_;
  typename Publisher<T>::SharedPtr publisher_;
  std::size_t receivers_;
  ipc_shared_ptr<T> loan_;
};

template <class T, class Executor>
class ExecutorReceiver final : public Receiver {
 public:
  explicit ExecutorReceiver(const Carriage& carriage) : node_(node_name("receiver")) {
    executor_.add_node(node_);
    subscription_ = node_.create_subscription<T>(
        carriage.topic, QoS(carriage.depth), [this](const ipc_shared_ptr<const T>& message) {
          (*on_message_)(message->bytes, sizeof message->bytes);
        });
  }
  void run(const OnMessage& on_message) override {
    on_message_ = &on_message;
    executor_.spin();
  }
  void stop() override { executor_.cancel(); }

 private:
  const OnMessage* on_message_ = nullptr;
  Node node_;
  Executor executor_;
  typename Subscription<T>::SharedPtr subscription_;
};

template <class T, std::size_t at_once>
class PollingReceiver final : public Receiver {
 public:
  explicit PollingReceiver(const Carriage& carriage)
      : node_(node_name("receiver")),
        subscription_(node_.create_subscription<T>(carriage.topic, QoS(carriage.depth))) {}
  void run(const OnMessage& on_message) override {
    while (!is_stopped_.load(std::memory_order_relaxed)) {
      if constexpr (at_once == 1) {
        while (const auto message = subscription_->take())
          on_message(message->bytes, sizeof message->bytes);
      } else {
        ipc_shared_ptr<const T> messages[at_once];
        const std::size_t count = subscription_->take_batch(messages, at_once);
        for (std::size_t i = 0; i < count; ++i)
          on_message(messages[i]->bytes, sizeof messages[i]->bytes);
      }
    }
  }
  void stop() override { is_stopped_ = true; }

 private:
  Node node_;
  typename PollingSubscriber<T>::SharedPtr subscription_;
  std::atomic<bool> is_stopped_{false};
};

template <class T>
using SingleThreaded = ExecutorReceiver<T, SingleThreadedExecutor>;
template <class T>
using Spinning = ExecutorReceiver<T, SpinningExecutor>;
template <class T>
using Taking = PollingReceiver<T, 1>;
template <class T>
using TakingBatches = PollingReceiver<T, 16>;

// Selects the type that is as long as the payload.
template <class Side, template <class> class Kind>
std::unique_ptr<Side> make(const Carriage& carriage) {
  if (carriage.bytes == small_bytes) return std::make_unique<Kind<SmallBytes>>(carriage);
  if (carriage.bytes == large_bytes) return std::make_unique<Kind<LargeBytes>>(carriage);
  throw std::runtime_error("throughput: no message type of this size");
}

std::vector<std::string> with_hook() {
  return {"LD_PRELOAD=" + path_of("libagnocast_heaphook.so")};
}

template <template <class> class Kind>
System agnocast_system(std::string_view name, std::string_view summary, bool is_spinning) {
  return {.name = name,
          .summary = summary,
          .make_sender = make<Sender, AgnocastSender>,
          .make_receiver = make<Receiver, Kind>,
          .service = "agnocastd",
          .environment = with_hook,
          .is_spinning = is_spinning};
}

}  // namespace

std::vector<System> agnocast_systems() {
  return {
      agnocast_system<SingleThreaded>("agnocast-executor", "SingleThreadedExecutor", false),
      agnocast_system<Spinning>("agnocast-spin-sleep", "SpinningExecutor, spins 50 us, then sleeps",
                                false),
      agnocast_system<Taking>("agnocast-take", "take() again and again", true),
      agnocast_system<TakingBatches>("agnocast-batch", "take_batch() of 16 again and again", true),
  };
}

}  // namespace agnocast::bench::throughput
