// SPDX-License-Identifier: Apache-2.0
//
// Cyclone DDS with as many passes over the bytes as rmw_cyclonedds makes: one from the message
// into the sample, one from the packets into a buffer (in Cyclone's thread), one from there into
// the reader's message (in the node's thread, which a waitset wakes). Uses parts of the bridge.

#include <bench/pipeline/edge.hpp>

#include <bridge/cdr/cdr.hpp>
#include <bridge/dds/names.hpp>
#include <bridge/dds/participant.hpp>

#include <sensor_msgs/msg/detail/point_cloud2__rosidl_typesupport_introspection_cpp.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>

#include <rosidl_typesupport_introspection_cpp/message_type_support_decl.hpp>

#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstring>
#include <stdexcept>
#include <utility>

namespace agnocast::bench::pipeline {
namespace {

using bridge::CdrType;
using bridge::DdsParticipant;

const CdrType& cdr_type() {
  static const CdrType type =
      CdrType::of(
          *static_cast<const MessageMembers*>(
              rosidl_typesupport_introspection_cpp::get_message_type_support_handle<Cloud>()->data))
          .value();
  return type;
}

template <class Value>
Value checked(bridge::DdsResult<Value> result) {
  if (!result) throw std::runtime_error("Cyclone DDS: " + result.error().text());
  return std::move(*result);
}

constexpr const char* type_name = "sensor_msgs::msg::dds_::PointCloud2_";
std::string dds_topic(const Lidar& lidar) { return "rt" + topic_of(lidar); }
bridge::DdsQos qos() {
  bridge::DdsQos qos;
  qos.depth = edge_depth;
  return qos;
}

class DdsSender final : public CloudSender {
 public:
  explicit DdsSender(const Lidar& lidar)
      : participant_(checked(DdsParticipant::create({}))),
        writer_(checked(participant_->create_writer(dds_topic(lidar), type_name, qos()))) {}

  bool is_matched() override { return writer_->matched() == 1; }
  Cloud& borrow() override {
    cloud_ = std::make_unique<Cloud>();
    return *cloud_;
  }
  void send() override {
    const auto fill = [this](std::span<std::byte> room) -> std::size_t {
      return bridge::write_cdr(cdr_type(), cloud_.get(), room).value_or(0);
    };
    const auto source_time = std::chrono::system_clock::now().time_since_epoch();
    const std::size_t bytes = bridge::cdr_bytes(cdr_type(), cloud_.get());
    if (checked(writer_->write(bytes, fill, std::chrono::nanoseconds(source_time).count())) !=
        bridge::WriteOutcome::sent)
      throw std::runtime_error("Cyclone DDS: a message was not sent");
    cloud_.reset();
  }

 private:
  std::unique_ptr<DdsParticipant> participant_;
  std::unique_ptr<bridge::DdsWriter> writer_;
  std::unique_ptr<Cloud> cloud_;
};

/// A serialized message as received.
struct Serialized {
  std::unique_ptr<std::byte[]> bytes;
  std::size_t size = 0;
};
std::shared_ptr<void> joined(bridge::RawPieces pieces) {
  auto whole = std::make_shared<Serialized>();
  for (const auto piece : pieces) whole->size += piece.size();
  whole->bytes = std::make_unique_for_overwrite<std::byte[]>(whole->size);
  std::byte* to = whole->bytes.get();
  for (const auto piece : pieces) {
    std::memcpy(to, piece.data(), piece.size());
    to += piece.size();
  }
  return whole;
}

class DdsReceiver final : public CloudReceiver {
 public:
  explicit DdsReceiver(OnCloud on_cloud)
      : on_cloud_(std::move(on_cloud)), participant_(checked(DdsParticipant::create({}))) {
    for (const Lidar& lidar : lidars())
      readers_.push_back(
          checked(participant_->create_reader(dds_topic(lidar), type_name, qos(), joined)));
  }

  bool is_matched() override {
    for (const auto& reader : readers_) {
      if (reader->matched() != 1) return false;
    }
    return true;
  }
  void run() override {
    while (!is_stopped_) {
      const DdsParticipant::Ready ready = checked(participant_->wait(std::chrono::seconds(1)));
      if (ready.discovery) (void)participant_->discovered();
      for (std::size_t i = 0; i < readers_.size(); ++i) take_all(i);
    }
  }
  void stop() override {
    is_stopped_ = true;
    participant_->interrupt();
  }

 private:
  void take_all(std::size_t lidar) {
    while (const auto sample = readers_[lidar]->take()) {
      if (sample->state != bridge::DdsSample::State::valid) continue;
      const auto& whole = *static_cast<const Serialized*>(sample->object.get());
      const std::span<const std::byte> bytes(whole.bytes.get(), whole.size);
      auto cloud = std::make_shared<Cloud>();
      if (const auto read = bridge::read_cdr(cdr_type(), {&bytes, 1}, cloud.get()); !read)
        throw std::runtime_error("Cyclone DDS: a message came changed: " + read.error().text());
      on_cloud_(lidar, std::move(cloud));
    }
  }

  OnCloud on_cloud_;
  std::unique_ptr<DdsParticipant> participant_;
  std::vector<std::unique_ptr<bridge::DdsReader>> readers_;
  std::atomic<bool> is_stopped_{false};
};

}  // namespace

const Edge cyclonedds_edge{
    .name = "cyclonedds-tuned",
    .make_sender = [](const Lidar& lidar) -> std::unique_ptr<CloudSender> {
      return std::make_unique<DdsSender>(lidar);
    },
    .make_receiver = [](CloudReceiver::OnCloud on_cloud) -> std::unique_ptr<CloudReceiver> {
      return std::make_unique<DdsReceiver>(std::move(on_cloud));
    }};

}  // namespace agnocast::bench::pipeline
