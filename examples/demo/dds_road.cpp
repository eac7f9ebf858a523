// SPDX-License-Identifier: Apache-2.0
//
// Cyclone DDS with the QoS of a ROS 2 sensor topic made reliable: keep-last 1. The transport's
// settings come from CYCLONEDDS_URI, which the demo sets.

#include <examples/demo/ack.hpp>
#include <examples/demo/dds_road.hpp>

#include <dds/dds.h>
#include <point_cloud2.h>

#include <cstring>
#include <utility>

namespace demo {
namespace {

using Sample = sensor_msgs_msg_dds__PointCloud2_;

struct DdsAccess {
  template <class Sequence>
  static std::size_t size(const Sequence& items) noexcept {
    return items._length;
  }
  template <class Sequence>
  static auto begin(const Sequence& items) noexcept {
    return items._buffer;
  }
  static std::string_view text(const char* text) noexcept { return text; }
};

class Participant {
 public:
  Participant() noexcept : entity_(dds_create_participant(DDS_DOMAIN_DEFAULT, nullptr, nullptr)) {}
  ~Participant() { (void)dds_delete(entity_); }
  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;
  dds_entity_t entity() const noexcept { return entity_; }
  dds_entity_t topic(const std::string& name) const {
    return dds_create_topic(entity_, &sensor_msgs_msg_dds__PointCloud2__desc, name.c_str(), nullptr,
                            nullptr);
  }

 private:
  dds_entity_t entity_;
};

struct QosDelete {
  void operator()(dds_qos_t* qos) const noexcept { dds_delete_qos(qos); }
};

std::unique_ptr<dds_qos_t, QosDelete> reliable() {
  std::unique_ptr<dds_qos_t, QosDelete> qos(dds_create_qos());
  dds_qset_reliability(qos.get(), DDS_RELIABILITY_RELIABLE, DDS_SECS(2));
  dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, 1);
  return qos;
}

class CycloneWriter final : public DdsWriter {
 public:
  explicit CycloneWriter(const std::string& topic) {
    const auto qos = reliable();
    writer_ =
        dds_create_writer(participant_.entity(), participant_.topic(topic), qos.get(), nullptr);
  }
  dds_entity_t entity() const noexcept { return writer_; }

  bool is_matched() override {
    dds_publication_matched_status_t status{};
    return dds_get_publication_matched_status(writer_, &status) == DDS_RETCODE_OK &&
           status.current_count > 0;
  }

  void fill(const Cloud& cloud) override {
    frame_id_ = cloud.header.frame_id;
    data_ = cloud.data;
    names_.clear();
    fields_.clear();
    for (const auto& field : cloud.fields) names_.push_back(field.name);
    for (std::size_t i = 0; i < cloud.fields.size(); ++i)
      fields_.push_back({names_[i].data(), cloud.fields[i].offset, cloud.fields[i].datatype,
                         cloud.fields[i].count});
    sample_.header.stamp = {cloud.header.stamp.sec, cloud.header.stamp.nanosec};
    sample_.header.frame_id = frame_id_.data();
    sample_.height = cloud.height;
    sample_.width = cloud.width;
    sample_.fields._buffer = fields_.data();
    sample_.fields._length = sample_.fields._maximum = static_cast<std::uint32_t>(fields_.size());
    sample_.is_bigendian = cloud.is_bigendian;
    sample_.point_step = cloud.point_step;
    sample_.row_step = cloud.row_step;
    sample_.data._buffer = data_.data();
    sample_.data._length = sample_.data._maximum = static_cast<std::uint32_t>(data_.size());
    sample_.is_dense = cloud.is_dense;
  }

  bool write() override { return dds_write(writer_, &sample_) == DDS_RETCODE_OK; }

 private:
  Participant participant_;
  dds_entity_t writer_ = 0;
  Sample sample_{};  // its memory belongs to the members below
  std::string frame_id_;
  std::vector<std::uint8_t> data_;
  std::vector<std::string> names_;
  std::vector<sensor_msgs_msg_dds__PointField_> fields_;
};

class CycloneReader final : public DdsReader {
 public:
  CycloneReader(const std::string& topic, Callback callback) : callback_(std::move(callback)) {
    const auto qos = reliable();
    dds_listener_t* const listener = dds_create_listener(this);
    dds_lset_data_available(listener, &CycloneReader::available);
    reader_ =
        dds_create_reader(participant_.entity(), participant_.topic(topic), qos.get(), listener);
    dds_delete_listener(listener);
  }
  dds_entity_t entity() const noexcept { return reader_; }

 private:
  static void available(dds_entity_t reader, void* self) noexcept {
    void* samples[1] = {nullptr};
    dds_sample_info_t infos[1];
    while (dds_take(reader, samples, infos, 1, 1) == 1) {
      const std::uint64_t received_ns = now_ns();
      if (infos[0].valid_data) {
        const auto& sample = *static_cast<const Sample*>(samples[0]);
        static_cast<CycloneReader*>(self)->callback_(
            static_cast<std::uint32_t>(sample.header.stamp.sec), is_intact<DdsAccess>(sample),
            received_ns);
      }
      (void)dds_return_loan(reader, samples, 1);
      samples[0] = nullptr;
    }
  }

  Callback callback_;
  Participant participant_;
  dds_entity_t reader_ = 0;
};

}  // namespace

std::unique_ptr<DdsWriter> DdsWriter::make(const std::string& topic, std::string& why) {
  auto writer = std::make_unique<CycloneWriter>(topic);
  if (writer->entity() > 0) return writer;
  why = std::string("Cyclone DDS does not start: ") + dds_strretcode(writer->entity());
  return nullptr;
}

std::unique_ptr<DdsReader> DdsReader::make(const std::string& topic, Callback callback,
                                           std::string& why) {
  auto reader = std::make_unique<CycloneReader>(topic, std::move(callback));
  if (reader->entity() > 0) return reader;
  why = std::string("Cyclone DDS does not start: ") + dds_strretcode(reader->entity());
  return nullptr;
}

}  // namespace demo
