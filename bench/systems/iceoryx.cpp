// SPDX-License-Identifier: Apache-2.0
//
// iceoryx 2.0: loans of plain bytes, in its three ways of waiting. Its daemon, RouDi, is the
// service "iox-roudi" (roudi.cpp).

#include <bench/systems/ready_count.hpp>

#include <iceoryx_hoofs/log/logmanager.hpp>
#include <iceoryx_posh/popo/listener.hpp>
#include <iceoryx_posh/popo/untyped_publisher.hpp>
#include <iceoryx_posh/popo/untyped_subscriber.hpp>
#include <iceoryx_posh/popo/user_trigger.hpp>
#include <iceoryx_posh/popo/wait_set.hpp>
#include <iceoryx_posh/runtime/posh_runtime.hpp>

#include <unistd.h>

#include <atomic>
#include <stdexcept>
#include <thread>
#include <utility>

namespace agnocast::bench {
namespace {

using iox::mepoo::ChunkHeader;
using iox::popo::UntypedSubscriber;

iox::capro::ServiceDescription service_of(const Carriage& carriage) {
  const iox::capro::IdString_t topic(iox::cxx::TruncateToCapacity, carriage.topic);
  iox::log::LogManager::GetLogManager().SetDefaultLogLevel(iox::log::LogLevel::kOff,
                                                           iox::log::LogLevelOutput::kHideLogLevel);
  // RouDi's name of this process. Without its monitoring, names of dead processes are never free
  // again.
  const std::string name = "agnocast-bench-iox-" + std::to_string(::getpid());
  iox::runtime::PoshRuntime::initRuntime(iox::RuntimeName_t(iox::cxx::TruncateToCapacity, name));
  return {"agnocast-bench", "bytes", topic};
}

class IceoryxSender final : public Sender {
 public:
  explicit IceoryxSender(const Carriage& carriage)
      : bytes_(static_cast<std::uint32_t>(carriage.bytes)),
        ready_(carriage),
        publisher_(service_of(carriage)) {}
  ~IceoryxSender() override {
    if (loan_ != nullptr) publisher_.release(loan_);
  }

  /// A publisher of iceoryx knows whether it has subscribers, but not their number.
  bool is_matched() override { return publisher_.hasSubscribers() && ready_.is_complete(); }
  std::byte* prepare() override {
    if (loan_ == nullptr)
      publisher_.loan(bytes_).and_then([this](void* payload) { loan_ = payload; });
    return static_cast<std::byte*>(loan_);
  }
  bool send() override {
    publisher_.publish(std::exchange(loan_, nullptr));
    return true;
  }

 private:
  std::uint32_t bytes_;
  ReadyCount ready_;
  iox::popo::UntypedPublisher publisher_;
  void* loan_ = nullptr;
};

/// Common part of the three kinds. Their wait() returns once stop() was called.
class IceoryxReceiver : public Receiver {
 public:
  void run(const OnMessage& on_message) final {
    on_message_ = &on_message;
    begin();
    while (!is_stopped() && subscriber_.getSubscriptionState() != iox::SubscribeState::SUBSCRIBED)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    ready_.add();
    wait();
    end();
  }
  void stop() override {
    is_stopped_.store(true, std::memory_order_release);
    is_stopped_.notify_all();
  }

 protected:
  explicit IceoryxReceiver(const Carriage& carriage)
      : ready_(carriage), subscriber_(service_of(carriage), options(carriage)) {}

  virtual void begin() {}
  virtual void wait() = 0;
  virtual void end() {}

  void take_all() {
    while (take_one()) continue;
  }
  bool take_one() {
    bool has_taken = false;
    subscriber_.take().and_then([&](const void* payload) {
      (*on_message_)(static_cast<const std::byte*>(payload),
                     ChunkHeader::fromUserPayload(payload)->userPayloadSize());
      subscriber_.release(payload);
      has_taken = true;
    });
    return has_taken;
  }
  bool is_stopped() const noexcept { return is_stopped_.load(std::memory_order_acquire); }
  void wait_for_stop() const noexcept { is_stopped_.wait(false, std::memory_order_acquire); }
  UntypedSubscriber& subscriber() noexcept { return subscriber_; }

 private:
  static iox::popo::SubscriberOptions options(const Carriage& carriage) {
    iox::popo::SubscriberOptions options;
    options.queueCapacity = carriage.depth;
    return options;
  }

  ReadyCount ready_;
  UntypedSubscriber subscriber_;
  const OnMessage* on_message_ = nullptr;
  std::atomic<bool> is_stopped_{false};
};

/// The callback runs in a thread of iceoryx.
class ListenerReceiver final : public IceoryxReceiver {
 public:
  explicit ListenerReceiver(const Carriage& carriage) : IceoryxReceiver(carriage) {}

 private:
  void begin() override {
    const auto attached = listener_.attachEvent(
        subscriber(), iox::popo::SubscriberEvent::DATA_RECEIVED,
        iox::popo::createNotificationCallback(ListenerReceiver::available, *this));
    if (attached.has_error()) throw std::runtime_error("iceoryx: the listener takes no subscriber");
  }
  void wait() override { wait_for_stop(); }
  void end() override {
    listener_.detachEvent(subscriber(), iox::popo::SubscriberEvent::DATA_RECEIVED);
  }
  static void available(UntypedSubscriber*, ListenerReceiver* self) { self->take_all(); }

  iox::popo::Listener listener_;
};

class WaitSetReceiver final : public IceoryxReceiver {
 public:
  explicit WaitSetReceiver(const Carriage& carriage) : IceoryxReceiver(carriage) {
    const bool is_attached =
        !wait_set_.attachState(subscriber(), iox::popo::SubscriberState::HAS_DATA).has_error() &&
        !wait_set_.attachEvent(stopper_).has_error();
    if (!is_attached) throw std::runtime_error("iceoryx: the wait set takes no subscriber");
  }
  void stop() override {
    IceoryxReceiver::stop();
    stopper_.trigger();
  }

 private:
  void wait() override {
    while (!is_stopped()) {
      (void)wait_set_.wait();
      take_all();
    }
  }

  iox::popo::WaitSet<2> wait_set_;
  iox::popo::UserTrigger stopper_;
};

class PollingReceiver final : public IceoryxReceiver {
 public:
  explicit PollingReceiver(const Carriage& carriage) : IceoryxReceiver(carriage) {}

 private:
  void wait() override {
    while (!is_stopped()) take_all();
  }
};

std::unique_ptr<Sender> make_sender(const Carriage& carriage) {
  return std::make_unique<IceoryxSender>(carriage);
}
template <class Kind>
std::unique_ptr<Receiver> make_receiver(const Carriage& carriage) {
  return std::make_unique<Kind>(carriage);
}

}  // namespace

std::vector<System> iceoryx_systems() {
  return {
      {.name = "iceoryx-listener",
       .summary = "iceoryx 2.0, a callback in the thread of its Listener",
       .make_sender = make_sender,
       .make_receiver = make_receiver<ListenerReceiver>,
       .service = "iox-roudi",
       .environment = nullptr},
      {.name = "iceoryx-waitset",
       .summary = "iceoryx 2.0, a thread that sleeps in a WaitSet",
       .make_sender = make_sender,
       .make_receiver = make_receiver<WaitSetReceiver>,
       .service = "iox-roudi",
       .environment = nullptr},
      {.name = "iceoryx-polling",
       .summary = "iceoryx 2.0, take() again and again",
       .make_sender = make_sender,
       .make_receiver = make_receiver<PollingReceiver>,
       .service = "iox-roudi",
       .environment = nullptr,
       .is_spinning = true},
  };
}

}  // namespace agnocast::bench
