// SPDX-License-Identifier: Apache-2.0
//
// RosGraph: which nodes there are. ROS 2 has none in DDS: each participant says on the topic
// ros_discovery_info which of its readers and writers belong to which of its nodes, whole at every
// change; who comes later gets the newest. This says it for the own participant and keeps what
// others say.
//
// There are two layouts under one type name. Until Humble a GUID takes 24 bytes, of which the last
// 8 are zero, since Iron 16. Both are read, by what parses to the end. One is written, and readers
// of the other do not understand it; so a graph can be told to speak as most others do.
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

/// Nodes of this host, by their full names.
using NodesByName = std::map<std::string, RosNode*>;

/// What one participant says, as one message.
struct RosEntities {
  Guid participant;
  std::vector<RosNode> nodes;
  GuidLayout layout = GuidLayout::humble;

  bool operator==(const RosEntities&) const = default;
};

/// With encapsulation; a multiple of 4 bytes.
std::vector<std::byte> write_entities(const RosEntities& entities);
/// Nothing unless the payload is one of the two layouts, with names that ROS 2 allows, and at most
/// 8 bytes behind it (Fast DDS leaves so many). Of a payload that is both, the one that leaves
/// less. Allocates in proportion to the payload, of which 1 MiB is read at most.
std::optional<RosEntities> read_entities(RawPieces payload);

/// USER_DATA by which rmw_cyclonedds finds the two endpoints of a client or a server: `id` is the
/// first 12 bytes of the participant's GUID and a number, big-endian.
enum class ServiceRole : std::uint8_t { client, server };
std::string service_user_data(ServiceRole role, const Guid& id);

class RosGraph {
 public:
  enum class Speak : std::uint8_t { humble, iron, detect };

  /// Creates a writer and a reader of ros_discovery_info. `participant` must outlive it.
  [[nodiscard]] static DdsResult<std::unique_ptr<RosGraph>> create(DdsParticipant& participant,
                                                                   Speak speak);

  /// Says that these are the nodes of the own participant; nothing is sent if that was said before.
  [[nodiscard]] DdsResult<void> set_nodes(std::vector<RosNode> nodes);

  /// Takes what came, and forgets participants that are gone. True if others() changed. To be
  /// called when wait() names reader() or discovery. If `detect` now means the other layout, or a
  /// sample could not be sent before, the own nodes are said again.
  [[nodiscard]] DdsResult<bool> update();

  using Others = std::map<Guid, RosEntities>;
  const Others& others() const noexcept { return others_; }
  /// What is spoken now: of `detect` what most others speak, Humble's if nobody does or as many do. Other bridges do not
  /// count: they have a node of theirs (bridge_node) and say what they have heard.
  GuidLayout layout() const;
  const DdsReader* reader() const noexcept { return reader_.get(); }
  /// Messages that were none of either layout, or spoke for another participant. What is beyond
  /// Limit::discovery_info_bytes is counted there.
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
