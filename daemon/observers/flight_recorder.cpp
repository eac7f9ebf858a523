// SPDX-License-Identifier: Apache-2.0

#include <daemon/observers/flight_recorder.hpp>

#include <daemon/transport/client_channel.hpp>

#include <algorithm>
#include <optional>
#include <string_view>

namespace agnocast::daemon {
namespace {

using journal::Record;
using wire::Opcode;

std::optional<std::uint64_t> argument(const Record& record, std::string_view name) noexcept {
  const std::size_t index = journal::argument_index(record.type, name);
  if (index == journal::argument_count) return std::nullopt;
  return record.argument[index];
}

std::uint32_t pid_of(const Record& record, std::string_view name,
                     std::uint32_t otherwise) noexcept {
  const auto pid = argument(record, name);
  return pid ? static_cast<std::uint32_t>(*pid) : otherwise;
}

wire::JournalProcess process_of(const Registry& registry, std::optional<std::uint64_t> client,
                                std::optional<std::uint64_t> generation) noexcept {
  wire::JournalProcess process{};
  if (!client || !generation || *client >= registry.client_high()) return process;
  const ClientRecord& record = registry.client(static_cast<ClientIndex>(*client));
  if (record.generation > *generation) return process;
  process.pid = record.pid;
  process.name = name_of(record.name);
  return process;
}

wire::Name topic_of(const Registry& registry, const Record& record) noexcept {
  const auto topic = argument(record, "topic");
  const auto generation = argument(record, "generation");
  const auto kind = argument(record, "kind");
  if (!topic || !generation || *topic >= registry.topic_high() ||
      kind == static_cast<std::uint64_t>(Kind::region))
    return {};
  const TopicRecord& found = registry.topic(static_cast<TopicIndex>(*topic));
  return found.generation <= *generation ? name_of(found.name) : wire::Name{};
}

wire::JournalRecord packet_of_record(const Registry& registry, std::uint64_t lsn) noexcept {
  wire::JournalRecord packet{};
  packet.lsn = lsn;
  const auto record = registry.log().read(lsn);
  if (!record) {
    packet.state = wire::JournalState::damaged;
    return packet;
  }
  packet.state = lsn > registry.log().applied_lsn() ? wire::JournalState::pending
                                                    : wire::JournalState::applied;
  packet.stamp_ns = record->stamp_ns;
  packet.type = static_cast<std::uint32_t>(record->type);
  std::copy(std::begin(record->argument), std::end(record->argument), packet.argument);
  packet.topic = topic_of(registry, *record);
  const auto generation = argument(*record, "generation");
  packet.process = process_of(registry, argument(*record, "client"), generation);
  auto receiver = argument(*record, "to");
  auto receiver_generation = argument(*record, "to_generation");
  if (!receiver) {
    receiver = argument(*record, "by");
    receiver_generation = argument(*record, "by_generation");
  }
  if (!receiver) {
    receiver = argument(*record, "reader");
    receiver_generation = argument(*record, "reader_generation");
  }
  packet.receiver = process_of(registry, receiver, receiver_generation);
  // The record's own pid stays valid when the place has another owner.
  if (argument(*record, "client")) packet.process.pid = pid_of(*record, "pid", packet.process.pid);
  packet.receiver.pid = pid_of(*record, "reader_pid", packet.receiver.pid);
  return packet;
}
static_assert(std::size(wire::JournalRecord{}.argument) == journal::argument_count);

template <class Body>
Outgoing outgoing(Opcode opcode, std::uint64_t request, Body body) {
  body.header = {opcode, sizeof body, request};
  const auto bytes = packet_of(body);
  return {{bytes.begin(), bytes.end()}, {}};
}

}  // namespace

std::vector<Outgoing> make_journal(const Registry& registry, const wire::ReadJournal& request,
                                   std::uint64_t now_ns) {
  const std::uint64_t id = request.header.request;
  wire::JournalEnd end{};
  end.oldest = registry.log().oldest_lsn();
  end.newest = registry.log().committed_lsn();
  end.now_ns = now_ns;
  const std::uint64_t last = request.last == 0 ? end.newest : std::min(request.last, end.newest);
  const std::uint64_t there = last < end.oldest || end.oldest == 0 ? 0 : last - end.oldest + 1;
  end.record_count = std::min(request.count, there);
  std::vector<Outgoing> packets;
  packets.reserve(end.record_count + 1);
  for (std::uint64_t i = 0; i < end.record_count; ++i) {
    packets.push_back(outgoing(Opcode::journal_record, id,
                               packet_of_record(registry, last - end.record_count + 1 + i)));
  }
  packets.push_back(outgoing(Opcode::journal_end, id, end));
  return packets;
}

}  // namespace agnocast::daemon
