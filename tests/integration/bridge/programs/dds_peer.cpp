// SPDX-License-Identifier: Apache-2.0
//
// The other process of the DDS tests, steered line by line: raw endpoints like the bridge's, and
// those of a plain program of Cyclone DDS with types of idlc.
//   dds_peer DOMAIN

#include <tests/integration/bridge/dds/dds_side.hpp>

#include <dds/dds.h>
#include <point_cloud2.h>
#include <ros_string.h>

#include <algorithm>
#include <cstring>
#include <iostream>
#include <map>
#include <sstream>
#include <string>

namespace agnocast::test {
namespace {

using String = std_msgs_msg_dds__String_;
using Cloud = sensor_msgs_msg_dds__PointCloud2_;

/// The endpoints of a program that knows only DDS.
class Plain {
 public:
  explicit Plain(dds_domainid_t domain)
      : participant_(dds_create_participant(domain, nullptr, nullptr)) {
    dds_qset_reliability(qos_, DDS_RELIABILITY_RELIABLE, DDS_SECS(10));
    dds_qset_history(qos_, DDS_HISTORY_KEEP_LAST, 10);
    string_ = endpoints(&std_msgs_msg_dds__String__desc, "String");
    cloud_ = endpoints(&sensor_msgs_msg_dds__PointCloud2__desc, "Cloud");
  }

  std::string send_string(const std::string& text) {
    String sample{const_cast<char*>(text.c_str())};
    return send(string_, &sample);
  }
  std::string send_cloud(std::size_t size) {
    Bytes data = pattern(size);
    char frame[] = "map", x[] = "x";
    sensor_msgs_msg_dds__PointField_ field{x, 4, 7, 1};
    Cloud cloud{};
    cloud.header.stamp = {-5, 7};
    cloud.header.frame_id = frame;
    cloud.height = 1;
    cloud.width = 2;
    cloud.fields = {1, 1, &field, false};
    cloud.point_step = 3;
    cloud.row_step = 6;
    cloud.data = {static_cast<std::uint32_t>(size), static_cast<std::uint32_t>(size),
                  reinterpret_cast<std::uint8_t*>(data.data() + 4), false};
    cloud.is_dense = true;
    return send(cloud_, &cloud);
  }
  std::string take_string() {
    return take(string_, [](const void* sample) {
      return std::string(static_cast<const String*>(sample)->data);
    });
  }
  std::string take_cloud() {
    return take(cloud_, [](const void* sample) {
      const auto& cloud = *static_cast<const Cloud*>(sample);
      const Bytes data = pattern(cloud.data._length);
      const bool is_equal = std::equal(data.begin() + 4, data.end(),
                                       reinterpret_cast<const std::byte*>(cloud.data._buffer));
      std::ostringstream text;
      text << cloud.header.stamp.sec << ' ' << cloud.header.stamp.nanosec << ' '
           << cloud.header.frame_id << ' ' << cloud.fields._length << ' '
           << cloud.fields._buffer[0].name << ' ' << cloud.row_step << ' ' << cloud.data._length
           << (is_equal ? " equal" : " differs") << (cloud.is_dense ? " dense" : "");
      return text.str();
    });
  }
  /// Returns what another participant's writer of a topic announces beside QoS.
  std::string announced(const std::string& topic) {
    const dds_entity_t reader =
        dds_create_reader(participant_, DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr);
    dds_guid_t own{};
    dds_get_guid(participant_, &own);
    std::string text;
    eventually(reader, [&](const void* sample) {
      auto* const endpoint = static_cast<dds_builtintopic_endpoint_t*>(const_cast<void*>(sample));
      if (endpoint->topic_name == nullptr || endpoint->topic_name != topic ||
          std::equal(std::begin(own.v), std::end(own.v), endpoint->participant_key.v))
        return false;
      std::uint32_t count = 0;
      dds_data_representation_id_t* ids = nullptr;
      if (dds_qget_data_representation(endpoint->qos, &count, &ids)) {
        for (std::uint32_t i = 0; i < count; ++i)
          text += "xcdr" + std::to_string(ids[i] + (ids[i] == 0)) + " ";
        dds_free(ids);
      }
      const dds_typeinfo_t* type = nullptr;
      const auto code = dds_builtintopic_get_endpoint_type_info(endpoint, &type);
      text += code >= 0 && type != nullptr ? "typed" : "untyped";
      return true;
    });
    dds_delete(reader);
    return text;
  }

 private:
  struct Endpoints {
    dds_entity_t writer, reader;
  };

  Endpoints endpoints(const dds_topic_descriptor_t* type, const std::string& name) {
    const auto topic = [&](const std::string& full) {
      return dds_create_topic(participant_, type, full.c_str(), nullptr, nullptr);
    };
    return {dds_create_writer(participant_, topic("rt/from" + name), qos_, nullptr),
            dds_create_reader(participant_, topic("rt/to" + name), qos_, nullptr)};
  }
  static std::string send(const Endpoints& of, const void* sample) {
    const auto end = std::chrono::steady_clock::now() + patience;
    dds_publication_matched_status_t status{};
    while (status.current_count == 0 && std::chrono::steady_clock::now() < end) {
      dds_sleepfor(DDS_MSECS(5));
      dds_get_publication_matched_status(of.writer, &status);
    }
    const dds_return_t code = dds_write(of.writer, sample);
    return code < 0 ? dds_strretcode(code) : "sent";
  }
  template <class Use>
  std::string take(const Endpoints& of, const Use& use) {
    std::string text = "(nothing)";
    eventually(of.reader, [&](const void* sample) {
      text = use(sample);
      return true;
    });
    return text;
  }
  template <class Use>
  static void eventually(dds_entity_t reader, const Use& use) {
    const auto end = std::chrono::steady_clock::now() + patience;
    while (std::chrono::steady_clock::now() < end) {
      void* sample = nullptr;
      dds_sample_info_t info;
      if (dds_take(reader, &sample, &info, 1, 1) <= 0) {
        dds_sleepfor(DDS_MSECS(5));
        continue;
      }
      const bool is_done = info.valid_data && use(sample);
      dds_return_loan(reader, &sample, 1);
      if (is_done) return;
    }
  }

  dds_entity_t participant_;
  dds_qos_t* qos_ = dds_create_qos();
  Endpoints string_{}, cloud_{};
};

class Peer {
 public:
  explicit Peer(std::uint32_t domain) : domain_(domain) {}

  std::string answer(const std::string& line) {
    std::istringstream words(line);
    std::string what, topic, rest;
    words >> what >> topic;
    std::getline(words >> std::ws, rest);
    if (what == "send-string") return plain().send_string(topic);
    if (what == "send-cloud") return plain().send_cloud(std::stoul(topic));
    if (what == "take-string") return plain().take_string();
    if (what == "take-cloud") return plain().take_cloud();
    if (what == "announced") return plain().announced(topic);
    if (what == "plain") return plain(), "ready";
    if (what == "writer" || what == "reader") return create(what, topic, rest);
    if (what == "delete") return writers_.erase(topic) + readers_.erase(topic) > 0 ? "gone" : "?";
    if (what == "write") return write(topic, pattern(std::stoul(rest)));
    if (what == "write-hex") return write(topic, bytes_of(rest));
    if (what == "take") {
      const auto sample = next(raw(), *readers_.at(topic));
      return sample ? std::to_string(received(*sample).bytes.size() - 4) : "(nothing)";
    }
    if (what == "letters") return letters(topic, rest.at(0));
    if (what == "echo") return echo(std::stoul(topic));
    if (what == "speak") return speak(topic);
    if (what == "nodes") return say(topic);
    if (what == "others") return others(topic);
    return "?";
  }

 private:
  Plain& plain() {
    if (!plain_) plain_ = std::make_unique<Plain>(domain_);
    return *plain_;
  }
  DdsParticipant& raw() {
    if (!raw_) raw_ = std::move(DdsParticipant::create({.domain = domain_}).value());
    return *raw_;
  }
  std::string create(const std::string& what, const std::string& topic, const std::string& rest) {
    const std::size_t space = rest.find(' ');
    const std::string type = rest.substr(0, space);
    DdsQos qos = qos_of(rest.substr(space + 1));
    qos.user_data = "made for " + topic;
    if (what == "writer")
      writers_[topic] = std::move(raw().create_writer(topic, type, qos).value());
    else
      readers_[topic] = std::move(raw().create_reader(topic, type, qos, keep_bytes).value());
    return "made";
  }
  std::string write(const std::string& topic, const Bytes& bytes) {
    DdsWriter& writer = *writers_.at(topic);
    if (!until(raw(), [&] { return writer.matched() > 0; })) return "not matched";
    return send(writer, bytes).value() == bridge::WriteOutcome::sent ? "sent" : "not sent";
  }
  /// Takes the available samples: returns how many strings this topic had so far, and how many
  /// have another letter.
  std::string letters(const std::string& topic, char letter) {
    auto& [strings, strange] = letters_[topic];
    (void)raw().discovered();
    while (const auto sample = readers_.at(topic)->take()) {
      if (sample->state != DdsSample::State::valid) continue;
      const Bytes& bytes = received(*sample).bytes;
      std::uint32_t length = 0;  // including the zero
      if (bytes.size() >= 8) std::memcpy(&length, bytes.data() + 4, 4);
      const bool is_whole = length >= 1 && length <= bytes.size() - 8;
      ++strings;
      strange +=
          !is_whole || !std::all_of(bytes.begin() + 8, bytes.begin() + 8 + length - 1,
                                    [&](std::byte byte) { return byte == std::byte(letter); });
    }
    return std::to_string(strings) + ' ' + std::to_string(strange);
  }
  /// Sends the sample back; reports whether it was the expected one, and the number of its pieces.
  std::string echo(std::size_t size) {
    const auto sample = next(raw(), *readers_.at("rt/down"));
    if (!sample) return "(nothing)";
    Bytes wanted = pattern(size);
    wanted.resize((wanted.size() + 3) / 4 * 4);
    const std::string verdict = received(*sample).bytes == wanted ? "equal" : "differs";
    return verdict + " " + write("rt/up", pattern(size));
  }
  std::string speak(const std::string& layout) {
    using bridge::RosGraph;
    graph_ = std::move(RosGraph::create(raw(), layout == "iron"     ? RosGraph::Speak::iron
                                               : layout == "humble" ? RosGraph::Speak::humble
                                                                    : RosGraph::Speak::detect)
                           .value());
    return "made";
  }
  std::string say(const std::string& name) {
    bridge::RosNode node{"/peer", name, {}, {raw().guid()}};
    return graph_->set_nodes({node}) ? "said" : "not said";
  }
  /// Waits until a node of this name is known.
  std::string others(const std::string& name) {
    std::string text = "(nobody)";
    until(raw(), [&] {
      (void)graph_->update();
      for (const auto& [participant, entities] : graph_->others())
        for (const auto& node : entities.nodes) {
          if (node.name != name) continue;
          text = node.name_space + " " + std::to_string(node.readers.size()) + " readers " +
                 std::to_string(node.writers.size()) + " writers " +
                 (entities.layout == bridge::GuidLayout::iron ? "iron" : "humble");
          return true;
        }
      return false;
    });
    return text;
  }

  std::uint32_t domain_;
  std::unique_ptr<Plain> plain_;
  std::unique_ptr<DdsParticipant> raw_;
  std::unique_ptr<bridge::RosGraph> graph_;
  std::map<std::string, std::unique_ptr<DdsWriter>> writers_;
  std::map<std::string, std::unique_ptr<DdsReader>> readers_;
  std::map<std::string, std::pair<std::uint64_t, std::uint64_t>> letters_;
};

}  // namespace
}  // namespace agnocast::test

int main(int count, char** arguments) {
  if (count != 2) return 2;
  agnocast::test::Peer peer(static_cast<std::uint32_t>(std::stoul(arguments[1])));
  for (std::string line; std::getline(std::cin, line);) std::cout << peer.answer(line) << std::endl;
}
