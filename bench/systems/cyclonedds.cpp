// SPDX-License-Identifier: Apache-2.0
//
// Eclipse Cyclone DDS: ROS 2's type for point clouds, with sequences of any length, through the C
// interface. Reliable, keep-last; the callback is a listener's. The systems differ only in the
// configuration (cyclonedds_settings.hpp). There is nothing to set for latency: the receiving
// thread calls the listener itself, which is the default for any latency budget
// (SynchronousDeliveryLatencyBound is infinite).
//
// "cyclonedds-iceoryx": Cyclone silently falls back to the network if it cannot use shared memory
// (no memory of RouDi, an incompatible quality of service), so both sides check that the entity has
// a port of iceoryx, and throw if it has none. A message through iceoryx that arrives before its
// reader has discovered the writer is dropped, though the writer knows the reader: so readers count
// themselves as well.

#include <bench/systems/cyclonedds_settings.hpp>
#include <bench/systems/ready_count.hpp>

#include <dds/dds.h>
#include <dds/ddsc/dds_loan_api.h>
#include <point_cloud2.h>

#include <atomic>
#include <cstdlib>
#include <stdexcept>
#include <string_view>
#include <thread>

namespace agnocast::bench {
namespace {

using Sample = sensor_msgs_msg_dds__PointCloud2_;

/// Checks a return code, or an entity, which is negative if there is none.
dds_entity_t checked(dds_entity_t result, const char* what) {
  if (result < 0)
    throw std::runtime_error(std::string("Cyclone DDS: ") + what + ": " + dds_strretcode(-result));
  return result;
}

/// A participant, its topic, and the QoS of all endpoints of the comparison.
class Participation {
 public:
  explicit Participation(const Carriage& carriage)
      : participant_(checked(dds_create_participant(DDS_DOMAIN_DEFAULT, nullptr, nullptr),
                             "no participant; is CYCLONEDDS_URI in order?")),
        qos_(dds_create_qos()) {
    dds_qset_reliability(qos_, DDS_RELIABILITY_RELIABLE, DDS_SECS(2));
    dds_qset_durability(qos_, DDS_DURABILITY_VOLATILE);
    dds_qset_history(qos_, DDS_HISTORY_KEEP_LAST, static_cast<std::int32_t>(carriage.depth));
    topic_ = checked(dds_create_topic(participant_, &sensor_msgs_msg_dds__PointCloud2__desc,
                                      carriage.topic.c_str(), nullptr, nullptr),
                     "no topic");
  }
  ~Participation() {
    dds_delete_qos(qos_);
    (void)dds_delete(participant_);
  }
  Participation(const Participation&) = delete;
  Participation& operator=(const Participation&) = delete;

  dds_entity_t writer() const {
    return judged(checked(dds_create_writer(participant_, topic_, qos_, nullptr), "no writer"));
  }
  dds_entity_t reader() const {
    return judged(checked(dds_create_reader(participant_, topic_, qos_, nullptr), "no reader"));
  }

 private:
  static dds_entity_t judged(dds_entity_t entity) {
    const char* const configuration = std::getenv("CYCLONEDDS_URI");
    const bool is_wanted =
        configuration != nullptr &&
        std::string_view(configuration).find("<SharedMemory>") != std::string_view::npos;
    if (dds_is_shared_memory_available(entity) != is_wanted)
      throw std::runtime_error(
          is_wanted ? "Cyclone DDS is configured to use iceoryx but does not; was it built with it?"
                    : "Cyclone DDS uses iceoryx without being configured to");
    return entity;
  }

  dds_entity_t participant_;
  dds_qos_t* qos_;
  dds_entity_t topic_ = 0;
};

class CycloneSender final : public Sender {
 public:
  explicit CycloneSender(const Carriage& carriage)
      : ready_(carriage),
        receivers_(carriage.receivers),
        participation_(carriage),
        data_(carriage.bytes) {
    sample_.header.frame_id = frame_id_;
    sample_.height = 1;
    sample_.width = sample_.row_step = static_cast<std::uint32_t>(data_.size());
    sample_.point_step = 1;
    sample_.data._buffer = data_.data();
    sample_.data._length = sample_.data._maximum = static_cast<std::uint32_t>(data_.size());
    writer_ = participation_.writer();
  }

  bool is_matched() override { return ready_.is_complete() && has_readers(); }
  std::byte* prepare() override { return reinterpret_cast<std::byte*>(data_.data()); }
  bool send() override { return dds_write(writer_, &sample_) == DDS_RETCODE_OK; }

 private:
  bool has_readers() const noexcept {
    dds_publication_matched_status_t status{};
    return dds_get_publication_matched_status(writer_, &status) == DDS_RETCODE_OK &&
           status.current_count == receivers_;
  }

  ReadyCount ready_;
  std::size_t receivers_;
  Participation participation_;
  char frame_id_[6] = "lidar";
  std::vector<std::uint8_t> data_;
  Sample sample_{};  // its memory belongs to the members above
  dds_entity_t writer_ = 0;
};

class CycloneReceiver final : public Receiver {
 public:
  explicit CycloneReceiver(const Carriage& carriage)
      : ready_(carriage), participation_(carriage), reader_(participation_.reader()) {}

  void run(const OnMessage& on_message) override {
    on_message_ = &on_message;
    dds_listener_t* const listener = dds_create_listener(this);
    dds_lset_data_available(listener, &CycloneReceiver::available);
    (void)dds_set_listener(reader_, listener);
    dds_delete_listener(listener);
    while (!is_stopped() && !is_matched())
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    ready_.add();
    is_stopped_.wait(false, std::memory_order_acquire);
    // Waits for a running callback.
    (void)dds_set_listener(reader_, nullptr);
  }
  void stop() override {
    is_stopped_.store(true, std::memory_order_release);
    is_stopped_.notify_all();
  }

 private:
  bool is_stopped() const noexcept { return is_stopped_.load(std::memory_order_acquire); }
  bool is_matched() const noexcept {
    dds_subscription_matched_status_t status{};
    return dds_get_subscription_matched_status(reader_, &status) == DDS_RETCODE_OK &&
           status.current_count > 0;
  }

  /// Runs in the receiving thread of Cyclone DDS.
  static void available(dds_entity_t reader, void* self) {
    const OnMessage& on_message = *static_cast<CycloneReceiver*>(self)->on_message_;
    void* samples[1] = {nullptr};
    dds_sample_info_t infos[1];
    while (dds_take(reader, samples, infos, 1, 1) == 1) {
      const auto& data = static_cast<const Sample*>(samples[0])->data;
      if (infos[0].valid_data)
        on_message(reinterpret_cast<const std::byte*>(data._buffer), data._length);
      (void)dds_return_loan(reader, samples, 1);
      samples[0] = nullptr;
    }
  }

  std::atomic<bool> is_stopped_{false};
  const OnMessage* on_message_ = nullptr;
  ReadyCount ready_;
  Participation participation_;
  dds_entity_t reader_;
};

std::unique_ptr<Sender> make_sender(const Carriage& carriage) {
  return std::make_unique<CycloneSender>(carriage);
}
std::unique_ptr<Receiver> make_receiver(const Carriage& carriage) {
  return std::make_unique<CycloneReceiver>(carriage);
}

}  // namespace

std::vector<System> cyclonedds_systems() {
  return {
      {.name = "cyclonedds",
       .summary = "Cyclone DDS through the loopback interface, reliable, in its listener",
       .make_sender = make_sender,
       .make_receiver = make_receiver,
       .service = "",
       .environment = cyclonedds_over_network},
      {.name = "cyclonedds-tuned",
       .summary = "the same with packets of 64 KB and a large receive buffer",
       .make_sender = make_sender,
       .make_receiver = make_receiver,
       .service = "",
       .environment = cyclonedds_tuned},
      {.name = "cyclonedds-iceoryx",
       .summary = "Cyclone DDS through iceoryx' shared memory, reliable, in its listener",
       .make_sender = make_sender,
       .make_receiver = make_receiver,
       .service = "iox-roudi",
       .environment = cyclonedds_over_iceoryx},
  };
}

}  // namespace agnocast::bench
