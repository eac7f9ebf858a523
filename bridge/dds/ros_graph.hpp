// SPDX-License-Identifier: Apache-2.0
//
// RosGraph: the nodes in the ROS graph. DDS has no nodes: each participant publishes on the topic
// ros_discovery_info which of its readers and writers belong to which of its nodes, complete at
// every change; late joiners get the newest message. This class publishes it for its own
// participant and keeps the messages of others.
//
// There are two layouts under one type name. Until Humble a GUID takes 24 bytes, the last 8 of
// them zero; since Iron 16. This class reads both: one of them parses to the end. It writes only
// one, which readers of the other do not understand; `detect` writes that of most others.
//
// One thread, the participant's.
#pragma once

#include <bridge/dds/participant.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bridge {

enum class GuidLayout : std::uint8_t { humble, iron };

struct RosNode {
  std::string name_space;  ///< "/" or "/a/b"
  std::string name;        ///< "talker"
  std::vector<Guid> readers;
  std::vector<Guid> writers;

  bool operator==(const RosNode&) const = default;
};

/// Returns "/a/b/talker".
inline std::string full_name_of(const RosNode& node) {
  return (node.name_space == "/" ? "" : node.name_space) + '/' + node.name;
}

/// The entries for nodes of this host, by the nodes' full names. Nodes may share one.
using NodesByName = std::map<std::string, RosNode*>;

/// The entities of one participant, as one message.
struct RosEntities {
  Guid participant;
  std::vector<RosNode> nodes;
  GuidLayout layout = GuidLayout::humble;

  bool operator==(const RosEntities&) const = default;
};

/// Returns whether the participant is a bridge (bridge_node).
bool is_of_bridge(const RosEntities& entities);

/// Returns the message with its encapsulation; a multiple of 4 bytes.
std::vector<std::byte> write_entities(const RosEntities& entities);
/// Returns nothing unless the payload has one of the two layouts, with names that ROS 2 allows,
/// and at most 8 bytes after it (Fast DDS leaves up to 8). If it fits both, returns the one that
/// leaves less. Allocates in proportion to the payload, of which it reads at most 1 MiB.
std::optional<RosEntities> read_entities(RawPieces payload);

/// Returns the USER_DATA by which rmw_cyclonedds finds the two endpoints of a client or a server:
/// `id` is the first 12 bytes of the participant's GUID and a number, big-endian.
enum class ServiceRole : std::uint8_t { client, server };
std::string service_user_data(ServiceRole role, const Guid& id);

class RosGraph {
 public:
  enum class Speak : std::uint8_t { humble, iron, detect };

  /// Creates a writer and a reader of ros_discovery_info. `participant` must outlive it.
  [[nodiscard]] static DdsResult<std::unique_ptr<RosGraph>> create(DdsParticipant& participant,
                                                                   Speak speak);

  /// Publishes the nodes of the own participant; sends nothing if they have not changed.
  [[nodiscard]] DdsResult<void> set_nodes(std::vector<RosNode> nodes);

  /// Takes messages and removes participants that are gone. Returns true if others() changed. Call
  /// it when wait() names reader() or discovery. Publishes the own nodes again if `detect` now
  /// selects the other layout, or if a message could not be sent before.
  [[nodiscard]] DdsResult<bool> update();

  using Others = std::map<Guid, RosEntities>;
  const Others& others() const noexcept { return others_; }
  /// Returns the layout in use: for `detect` that of most others, at a tie or without others
  /// Humble's. Other bridges (bridge_node) do not count, because they only repeat what they
  /// detect.
  GuidLayout layout() const;
  const DdsReader* reader() const noexcept { return reader_.get(); }
  /// Returns the number of messages that had neither layout or spoke for another participant.
  /// Messages beyond Limit::discovery_info_bytes are counted there.
  std::uint64_t refused() const noexcept { return reader_->refused() + impostors_; }

 private:
  explicit RosGraph(DdsParticipant& participant, Speak speak)
      : participant_(participant), speak_(speak) {}
  DdsResult<void> say();

  DdsParticipant& participant_;
  Speak speak_;
  std::unique_ptr<DdsWriter> writer_;
  std::unique_ptr<DdsReader> reader_;
  std::vector<RosNode> nodes_;
  std::optional<RosEntities> said_;
  bool has_nodes_ = false;
  Others others_;
  std::size_t others_bytes_ = 0;
  std::uint64_t impostors_ = 0;
};

}  // namespace agnocast::bridge
