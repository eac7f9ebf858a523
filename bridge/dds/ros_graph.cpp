// SPDX-License-Identifier: Apache-2.0

#include <bridge/dds/ros_graph.hpp>

#include <bridge/dds/names.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <span>
#include <utility>

namespace agnocast::bridge {
namespace {

constexpr std::size_t encapsulation_bytes = 4;
constexpr std::size_t payload_bytes_max = std::size_t{1} << 20;
constexpr std::size_t rest_bytes_max = 8;
constexpr std::size_t name_bytes_max = 256;
// Bound for the reader's cache until update() takes it: sixteen messages of the maximum size.
constexpr std::size_t unread_bytes_max = 16 * payload_bytes_max;
// Bound for one update(): others write as fast as they like, and the rest is ready the next time.
constexpr std::size_t takes_max = 64;

std::size_t guid_bytes(GuidLayout layout) { return layout == GuidLayout::humble ? 24 : 16; }

// Every member is a multiple of 4 bytes or follows a count, so 4 is the only alignment.
class Output {
 public:
  explicit Output(GuidLayout layout) : guid_bytes_(guid_bytes(layout)) {
    for (const int byte : {0, 1, 0, 0}) bytes_.push_back(std::byte(byte));
  }

  void guid(const Guid& guid) {
    append(guid.bytes.data(), guid.bytes.size());
    bytes_.resize(bytes_.size() + guid_bytes_ - guid.bytes.size());
  }
  void guids(const std::vector<Guid>& guids) {
    count(guids.size());
    for (const Guid& each : guids) guid(each);
  }
  void count(std::size_t value) {
    align();
    for (int shift = 0; shift < 32; shift += 8) bytes_.push_back(std::byte(value >> shift & 0xff));
  }
  void text(const std::string& text) {
    count(text.size() + 1);
    append(text.c_str(), text.size() + 1);
  }
  std::vector<std::byte> take() && {
    align();
    return std::move(bytes_);
  }

 private:
  void align() { bytes_.resize((bytes_.size() + 3) / 4 * 4); }
  void append(const void* from, std::size_t size) {
    const auto* const bytes = static_cast<const std::byte*>(from);
    bytes_.insert(bytes_.end(), bytes, bytes + size);
  }

  std::size_t guid_bytes_;
  std::vector<std::byte> bytes_;
};

class Input {
 public:
  Input(std::span<const std::byte> payload, GuidLayout layout)
      : payload_(payload),
        at_(encapsulation_bytes),
        is_little_(payload[1] == std::byte{1}),
        guid_bytes_(guid_bytes(layout)) {}

  bool guid(Guid& guid) {
    if (left() < guid_bytes_) return false;
    const auto from = payload_.subspan(at_, guid_bytes_);
    std::memcpy(guid.bytes.data(), from.data(), guid.bytes.size());
    at_ += guid_bytes_;
    return std::all_of(from.begin() + std::ptrdiff_t(guid.bytes.size()), from.end(),
                       [](std::byte byte) { return byte == std::byte{0}; });
  }
  bool guids(std::vector<Guid>& guids) {
    std::size_t many = 0;
    if (!count(many) || many > left() / guid_bytes_) return false;
    guids.resize(many);
    return std::all_of(guids.begin(), guids.end(), [this](Guid& each) { return guid(each); });
  }
  bool count(std::size_t& value) {
    at_ += (4 - at_ % 4) % 4;
    if (left() < 4) return false;
    value = 0;
    for (std::size_t i = 0; i < 4; ++i)
      value |= std::to_integer<std::size_t>(payload_[at_ + i]) << 8 * (is_little_ ? i : 3 - i);
    at_ += 4;
    return true;
  }
  bool text(std::string& text) {
    std::size_t size = 0;
    if (!count(size) || size < 1 || size > left() || size > name_bytes_max + 1) return false;
    text.assign(reinterpret_cast<const char*>(payload_.data() + at_), size - 1);
    at_ += size;
    return payload_[at_ - 1] == std::byte{0};
  }
  std::size_t left() const { return at_ < payload_.size() ? payload_.size() - at_ : 0; }

 private:
  std::span<const std::byte> payload_;
  std::size_t at_;
  bool is_little_;
  std::size_t guid_bytes_;
};

// ASCII, whatever the locale.
bool is_name(std::string_view name) {
  return !name.empty() && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  });
}
bool is_namespace(std::string_view name) {
  if (name == "/") return true;
  if (name.empty()) return false;
  while (!name.empty()) {
    if (name.front() != '/') return false;
    name.remove_prefix(1);
    const std::string_view token = name.substr(0, name.find('/'));
    if (!is_name(token)) return false;
    name.remove_prefix(token.size());
  }
  return true;
}

// Returns the number of bytes left after the entities.
std::optional<std::size_t> read_as(GuidLayout layout, std::span<const std::byte> payload,
                                   RosEntities& entities) {
  // Namespace and name of at least one character each, and two counts.
  constexpr std::size_t node_bytes_min = 8 + 8 + 4 + 4;
  Input input(payload, layout);
  std::size_t nodes = 0;
  if (!input.guid(entities.participant) || !input.count(nodes) ||
      nodes > input.left() / node_bytes_min)
    return std::nullopt;
  entities.layout = layout;
  entities.nodes.resize(nodes);
  for (RosNode& node : entities.nodes) {
    if (!input.text(node.name_space) || !is_namespace(node.name_space) || !input.text(node.name) ||
        !is_name(node.name) || !input.guids(node.readers) || !input.guids(node.writers))
      return std::nullopt;
  }
  return input.left() <= rest_bytes_max ? std::optional(input.left()) : std::nullopt;
}

std::size_t memory_of(const RosEntities& entities) {
  std::size_t bytes = sizeof(RosEntities);
  for (const RosNode& node : entities.nodes)
    bytes += sizeof(RosNode) + node.name_space.size() + node.name.size() +
             sizeof(Guid) * (node.readers.size() + node.writers.size());
  return bytes;
}

}  // namespace

bool is_of_bridge(const RosEntities& entities) {
  return std::any_of(entities.nodes.begin(), entities.nodes.end(),
                     [](const RosNode& node) { return node.name.starts_with(bridge_node); });
}

std::vector<std::byte> write_entities(const RosEntities& entities) {
  Output output(entities.layout);
  output.guid(entities.participant);
  output.count(entities.nodes.size());
  for (const RosNode& node : entities.nodes) {
    output.text(node.name_space);
    output.text(node.name);
    output.guids(node.readers);
    output.guids(node.writers);
  }
  return std::move(output).take();
}

std::optional<RosEntities> read_entities(RawPieces payload) {
  std::vector<std::byte> bytes;
  for (const std::span<const std::byte> piece : payload) {
    if (piece.size() > payload_bytes_max - bytes.size()) return std::nullopt;
    bytes.insert(bytes.end(), piece.begin(), piece.end());
  }
  if (bytes.size() < encapsulation_bytes || bytes[0] != std::byte{0} || bytes[1] > std::byte{1})
    return std::nullopt;
  RosEntities humble, iron;
  const auto humble_rest = read_as(GuidLayout::humble, bytes, humble);
  const auto iron_rest = read_as(GuidLayout::iron, bytes, iron);
  if (humble_rest && (!iron_rest || *humble_rest <= *iron_rest)) return humble;
  if (iron_rest) return iron;
  return std::nullopt;
}

std::string service_user_data(ServiceRole role, const Guid& id) {
  std::string text = role == ServiceRole::client ? "clientid=" : "serviceid=";
  for (std::size_t i = 0; i < id.bytes.size(); ++i) {
    char digits[4];
    std::snprintf(digits, sizeof digits, i == 0 ? "%2x" : ".%x", id.bytes[i]);
    text += digits;
  }
  return text + ";";
}

DdsResult<std::unique_ptr<RosGraph>> RosGraph::create(DdsParticipant& participant, Speak speak) {
  constexpr auto topic = "ros_discovery_info";
  constexpr auto type = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";
  std::unique_ptr<RosGraph> graph(new RosGraph(participant, speak));
  DdsQos qos;
  qos.transient_local = true;
  auto writer = participant.create_writer(topic, type, qos);
  if (!writer) return tl::unexpected(writer.error());
  graph->writer_ = std::move(*writer);
  qos.keep_all = true;
  auto reader = participant.create_reader(
      topic, type, qos,
      [](RawPieces payload) -> std::shared_ptr<void> {
        auto entities = read_entities(payload);
        return entities ? std::make_shared<RosEntities>(std::move(*entities)) : nullptr;
      },
      unread_bytes_max);
  if (!reader) return tl::unexpected(reader.error());
  graph->reader_ = std::move(*reader);
  return graph;
}

DdsResult<void> RosGraph::set_nodes(std::vector<RosNode> nodes) {
  nodes_ = std::move(nodes);
  has_nodes_ = true;
  return say();
}

DdsResult<void> RosGraph::say() {
  RosEntities entities{participant_.guid(), nodes_, layout()};
  if (!has_nodes_ || said_ == entities) return {};
  const std::vector<std::byte> bytes = write_entities(entities);
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  const auto outcome = writer_->write(
      bytes.size(),
      [&bytes](std::span<std::byte> to) {
        std::copy(bytes.begin(), bytes.end(), to.begin());
        return bytes.size();
      },
      std::chrono::duration_cast<std::chrono::nanoseconds>(now).count());
  if (!outcome) return tl::unexpected(outcome.error());
  if (*outcome == WriteOutcome::sent) said_ = std::move(entities);
  return {};
}

DdsResult<bool> RosGraph::update() {
  bool is_changed = false;
  const auto& remotes = participant_.remotes();
  for (std::size_t i = 0; i < takes_max; ++i) {
    const auto sample = reader_->take();
    if (!sample) break;
    if (sample->state != DdsSample::State::valid) continue;
    const auto& entities = *static_cast<const RosEntities*>(sample->object.get());
    if (!sample->writer.is_of_participant(entities.participant)) {
      ++impostors_;
      continue;
    }
    if (!remotes.contains(entities.participant)) continue;  // gone since
    const auto known = others_.find(entities.participant);
    if (known != others_.end() && known->second == entities) continue;
    const std::size_t before = known == others_.end() ? 0 : memory_of(known->second);
    const std::size_t bytes = others_bytes_ - before + memory_of(entities);
    if (bytes > most_of(Limit::discovery_info_bytes)) {
      participant_.limits().refuse(Limit::discovery_info_bytes);
      continue;
    }
    others_bytes_ = bytes;
    others_[entities.participant] = entities;
    is_changed = true;
  }
  is_changed |= std::erase_if(others_, [&](const auto& other) {
                  if (remotes.contains(other.first)) return false;
                  others_bytes_ -= memory_of(other.second);
                  return true;
                }) != 0;
  if (const auto said = say(); !said) return tl::unexpected(said.error());
  return is_changed;
}

GuidLayout RosGraph::layout() const {
  if (speak_ == Speak::humble) return GuidLayout::humble;
  if (speak_ == Speak::iron) return GuidLayout::iron;
  std::size_t humble = 0, iron = 0;
  for (const auto& [participant, entities] : others_) {
    if (!is_of_bridge(entities)) ++(entities.layout == GuidLayout::iron ? iron : humble);
  }
  return iron > humble ? GuidLayout::iron : GuidLayout::humble;
}

}  // namespace agnocast::bridge
