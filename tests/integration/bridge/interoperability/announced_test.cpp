// SPDX-License-Identifier: Apache-2.0
//
// Goal: in discovery the bridge announces the same as a process of rmw_cyclonedds: the same
// parameters, with the same values except for their owner. Method: the packets that Cyclone DDS
// sends for the real bridge, captured in a file, compared with those recorded from ROS 2.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/unit/bridge/golden_sample.hpp>

#include <agnocast/agnocast.hpp>

#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <set>

namespace agnocast::test {
namespace {

using std_msgs::msg::String;

/// Value by parameter id, as hex.
using Parameters = std::map<unsigned, std::string>;

constexpr unsigned topic_name = 0x05, domain_id = 0x0f, reliability = 0x1a, unicast_locator = 0x31,
                   metatraffic_locator = 0x32, participant_guid = 0x50, property_list = 0x59,
                   endpoint_guid = 0x5a, host_and_version = 0x8007, receive_buffer_size = 0x8019,
                   history = 0x40;
constexpr const char *writer_kind = "03", *reader_kind = "04";
constexpr const char* reliable = "02000000";

class Reader {
 public:
  explicit Reader(Bytes bytes) : bytes_(std::move(bytes)) {}
  template <class Number = std::uint16_t>
  Number number(std::size_t at) const {
    Number value = 0;
    if (at + sizeof value <= bytes_.size()) std::memcpy(&value, bytes_.data() + at, sizeof value);
    return value;
  }
  std::string hex(std::size_t at, std::size_t size) const {
    return at + size <= bytes_.size() ? hex_of(std::span(bytes_).subspan(at, size)) : "";
  }
  std::size_t size() const { return bytes_.size(); }

 private:
  Bytes bytes_;
};

/// Returns the parameter lists of all discovery DATA of this capture, which has what its process
/// sent and received, but those that the participant with this GUID prefix sent.
std::vector<Parameters> sent_lists(const std::filesystem::path& capture,
                                   const std::string& others_prefix) {
  std::ifstream file(capture, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const auto* const bytes = reinterpret_cast<const std::byte*>(text.data());
  const Reader all(Bytes(bytes, bytes + text.size()));
  std::vector<Parameters> lists;
  // pcap: a header of 24 bytes; then for each packet 16, IP 20, UDP 8, RTPS 20.
  for (std::size_t at = 24; at + 64 <= all.size();) {
    const std::size_t end = at + 16 + all.number<std::uint32_t>(at + 8);
    if (all.hex(at + 52, 12) == others_prefix) {
      at = end;
      continue;
    }
    for (std::size_t part = at + 64; part + 4 <= end;) {
      const std::size_t length = all.number(part + 2);
      const std::string kind = all.hex(part, 1), writer = all.hex(part + 12, 4);
      // DATA with a payload of the SPDP or SEDP writers.
      if (kind == "15" && (writer == "000100c2" || writer == "000003c2" || writer == "000004c2") &&
          all.hex(part + 1, 1) == "05") {
        Parameters list;
        for (std::size_t p = part + 12 + all.number(part + 6); p + 4 <= end && all.number(p) != 1;
             p += std::size_t{4} + all.number(p + 2))
          list[all.number(p)] = all.hex(p + 4, all.number(p + 2));
        lists.push_back(list);
      }
      part += 4 + (length == 0 ? end : length);
    }
    at = end;
  }
  return lists;
}

/// Returns the parameters of a recorded list.
Parameters recorded_list(const Sample& sample) {
  Parameters list;
  for (const auto& parameter : sample.json.at("parameters"))
    list[static_cast<unsigned>(std::stoul(parameter.at("pid").get<std::string>(), nullptr, 16))] =
        parameter.at("value_hex").get<std::string>();
  return list;
}

/// Removes the values that differ for each process and each run; of a GUID the kind, reader or
/// writer, stays. The names of host and program, which Cyclone DDS announces for each process,
/// were not recorded.
Parameters comparable(Parameters list) {
  for (const unsigned named : {property_list, host_and_version}) list.erase(named);
  for (const unsigned own : {domain_id, unicast_locator, metatraffic_locator, receive_buffer_size,
                             participant_guid, endpoint_guid}) {
    if (const auto found = list.find(own); found != list.end())
      found->second = own == participant_guid || own == endpoint_guid
                          ? found->second.substr(found->second.size() - 2)
                          : std::to_string(found->second.size());
  }
  // Only its kind: the bridge announces another blocking time on purpose (participant.hpp). With
  // ROS's, it is a writer's default, which is not announced.
  if (list[endpoint_guid] == writer_kind) list.try_emplace(reliability, reliable);
  if (const auto found = list.find(reliability); found != list.end()) found->second.resize(8);
  // The depth of keep-all has no meaning, and the bridge reads deeper than its subscriptions on
  // purpose (dds_reader_depth_min).
  if (const auto found = list.find(history);
      found != list.end() &&
      (found->second.starts_with("01") || list[endpoint_guid] == reader_kind))
    found->second.resize(8);
  return list;
}

class Announced : public BridgeTest {};

TEST_F(Announced, EqualsTheRecordedAnnouncementsOfRmwCyclonedds) {
  if (recorded_samples().empty())
    GTEST_SKIP() << "AGNOCAST_GOLDEN_CDR_DIR names no folder of recorded packets";
  const std::filesystem::path capture = std::filesystem::path(daemon->directory()) / "sent.pcap";
  bridge_.reset();
  start_bridge({},
               {"CYCLONEDDS_URI=" +
                Domain::configuration("10 s", "<Tracing><PacketCaptureFile>" + capture.string() +
                                                  "</PacketCaptureFile></Tracing>")});
  const auto publisher = create_publisher<String>(PlainNode(), "/chatter", 10);
  const auto subscription = create_subscription<String>(PlainNode(), "/chatter", 10);
  DdsQos qos;
  qos.depth = 10;
  const DdsReader& reader = other_.reads<String>("rt/chatter", qos);
  const DdsWriter& writer = other_.writes("rt/chatter", dds_type_name<String>(), qos);
  ASSERT_TRUE(other_.eventually([&] { return reader.matched() == 1 && writer.matched() == 1; }));
  // The file is complete when the program ends.
  ::kill(bridge_->pid(), SIGTERM);
  ASSERT_EQ(bridge_->finish(), 0);

  const std::vector<Parameters> sent =
      sent_lists(capture, hex_of(std::as_bytes(std::span(reader.guid().bytes).first(12))));
  for (const char* const name :
       {"wire_spdp_participant.json", "wire_sedp_publisher_chatter.json",
        "wire_sedp_subscription_chatter.json", "wire_sedp_discovery_writer.json",
        "wire_sedp_discovery_reader.json"}) {
    SCOPED_TRACE(name);
    bool is_found = false;
    for (const Sample& sample : samples_with("parameters")) {
      if (sample.file != name) continue;
      is_found = true;
      const Parameters wanted = comparable(recorded_list(sample));
      std::set<Parameters> same_topic;
      for (const Parameters& list : sent) {
        if (wanted.contains(topic_name) == list.contains(topic_name) &&
            (!wanted.contains(topic_name) || wanted.at(topic_name) == list.at(topic_name)))
          same_topic.insert(comparable(list));
      }
      EXPECT_THAT(same_topic, testing::Contains(wanted));
    }
    EXPECT_TRUE(is_found);
  }
}

}  // namespace
}  // namespace agnocast::test
