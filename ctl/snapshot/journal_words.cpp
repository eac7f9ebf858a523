// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/journal.hpp>

#include <base/text/text.hpp>
#include <ctl/cli/console.hpp>
#include <journal/withdrawal.hpp>

#include <string_view>

namespace agnocast::ctl {
namespace {

using journal::DeathReason;
using journal::EndpointState;
using journal::LeaveCause;
using journal::RecordType;
using wire::JournalRecord;

RecordType type_of(const JournalRecord& record) noexcept {
  return static_cast<RecordType>(record.type);
}
bool has(const JournalRecord& record, std::string_view name) noexcept {
  return journal::argument_index(type_of(record), name) < journal::argument_count;
}
std::string number_of(const JournalRecord& record, std::string_view name) {
  return std::to_string(argument(record, name));
}

// Returns "lidar, pid 812".
std::string words_of(const wire::JournalProcess& process) {
  const std::string name = text_of(process.name);
  if (name.empty() && process.pid == 0) return "forgotten";
  const std::string pid = "pid " + std::to_string(process.pid);
  return name.empty() ? pid : escaped(name) + ", " + pid;
}
std::string receiver_of(const JournalRecord& record, std::string_view argument_name) {
  const std::string name = text_of(record.receiver.name);
  if (name.empty() && record.receiver.pid == 0)
    return "process " + number_of(record, argument_name) + " (forgotten)";
  return escaped(name) + " (pid " + std::to_string(record.receiver.pid) + ')';
}
std::string topic_of(const JournalRecord& record) {
  const std::string name = text_of(record.topic);
  return name.empty() ? "topic " + number_of(record, "topic") + " (forgotten)" : escaped(name);
}

bool is_about_subscription(const JournalRecord& record) noexcept {
  switch (type_of(record)) {
    case RecordType::add_subscription:
    case RecordType::leave_subscription:
    case RecordType::free_subscription:
    case RecordType::reader_mute:
      return true;
    default:
      return has(record, "kind") &&
             argument(record, "kind") == static_cast<std::uint64_t>(wire::Kind::subscription);
  }
}
bool is_about_memory(const JournalRecord& record) noexcept {
  return has(record, "kind") &&
         argument(record, "kind") == static_cast<std::uint64_t>(wire::Kind::region);
}

std::string leave_words(LeaveCause cause) {
  switch (cause) {
    case LeaveCause::left:
      return "left";
    case LeaveCause::nothing_open:
      return "ended with its process, nothing was open";
    case LeaveCause::rolled_back:
      return "ended with its process, last message rolled back";
    case LeaveCause::rolled_forward:
      return "ended with its process, last message rolled forward";
    case LeaveCause::corrupt:
      return "ended with its process, its last operation is corrupt";
  }
  return "ended";
}

std::string death_words(DeathReason reason) {
  switch (reason) {
    case DeathReason::died:
      return "died";
    case DeathReason::unmapped:
      return "unmapped its memory and still runs";
    case DeathReason::revoked:
      return "was revoked and still runs";
  }
  return "ended";
}

// Returns "subscription 3 (viewer, pid 977, uid 1001)".
std::string reader_words(const JournalRecord& record) {
  return "subscription " + number_of(record, "subscription") + " (" + words_of(record.receiver) +
         ", uid " + number_of(record, "reader_uid") + ')';
}

std::string recovered_words(const JournalRecord& record) {
  const std::uint64_t redone = argument(record, "redone_lsn");
  std::string text = redone == 0 ? "took over, no operation was in progress"
                                 : "took over, completed #" + std::to_string(redone);
  text += ", " + counted(argument(record, "dead_count"), "process", "processes") + " had died, " +
          counted(argument(record, "board_word_count"), "word") + " of the board rewritten";
  return text;
}

std::string endpoint_words(EndpointState state) {
  switch (state) {
    case EndpointState::leaving:
      return "left, may still hold messages";
    case EndpointState::over:
      return "released by all peers";
    case EndpointState::dead:
      return "ended with its process";
    case EndpointState::free:
      return "removed, its entry is free";
    case EndpointState::active:
    case EndpointState::orphan:
      break;
  }
  return "changed";
}

}  // namespace

bool is_damaged(const JournalRecord& record) noexcept {
  return record.state == wire::JournalState::damaged || journal::name_of(type_of(record)).empty();
}

std::uint64_t argument(const JournalRecord& record, std::string_view name) noexcept {
  const std::size_t index = journal::argument_index(type_of(record), name);
  return index < journal::argument_count ? record.argument[index] : 0;
}

std::string subject_of(const JournalRecord& record) {
  if (is_damaged(record)) return "record";
  if (type_of(record) == RecordType::recovered)
    return "agnocastd (pid " + number_of(record, "pid") + ')';
  if (is_about_memory(record))
    return "memory of process " + number_of(record, "client") + " (" + words_of(record.process) +
           ')';
  if (has(record, "index"))
    return (is_about_subscription(record) ? "subscription " : "publisher ") +
           number_of(record, "index") + " of " + topic_of(record) + " (" +
           words_of(record.process) + ')';
  if (has(record, "client"))
    return "process " + number_of(record, "client") + " (" + words_of(record.process) + ')';
  if (!text_of(record.topic).empty()) return "topic " + topic_of(record);
  return has(record, "topic") ? topic_of(record) : "agnocastd";
}

std::string deed_of(const JournalRecord& record) {
  if (is_damaged(record)) return "damaged: not a valid record";
  switch (type_of(record)) {
    case RecordType::none:
      return "nothing";
    case RecordType::register_client:
      return "joined, uid " + number_of(record, "uid") + ", domain " + number_of(record, "domain");
    case RecordType::add_publisher:
      return "created, " + counted(argument(record, "slot_count"), "slot");
    case RecordType::add_subscription:
      return "created, may hold " + counted(argument(record, "quota"), "message");
    case RecordType::announced:
      return receiver_of(record, "to") + " is notified";
    case RecordType::unlinked:
      return receiver_of(record, "by") + " has unmapped it";
    case RecordType::leave_publisher:
      return leave_words(static_cast<LeaveCause>(argument(record, "cause")));
    case RecordType::leave_subscription:
    case RecordType::free_publisher:
      return endpoint_words(static_cast<EndpointState>(argument(record, "state")));
    case RecordType::free_subscription:
    case RecordType::client_end:
      return endpoint_words(EndpointState::free);
    case RecordType::client_dead:
      return death_words(static_cast<DeathReason>(argument(record, "reason")));
    case RecordType::open_window:
      return "opened window " + number_of(record, "window") + " at " +
             hexadecimal(argument(record, "base")) + ", " +
             bytes_for_people(argument(record, "bytes"));
    case RecordType::add_topic:
      return "created";
    case RecordType::open_wait_set:
      return "opened wait set " + number_of(record, "wait_set");
    case RecordType::readers:
      return "publishes for one set of readers";
    case RecordType::free_topic:
      return "removed: it has no endpoints left";
    case RecordType::raise_slots:
      return "has " + counted(argument(record, "slot_count"), "slot") + " now";
    case RecordType::topic_forgotten:
      return "has unmapped everything of this topic";
    case RecordType::client_forgotten:
      return "has unmapped everything of other processes";
    case RecordType::recovered:
      return recovered_words(record);
    case RecordType::rejoined:
      return "came back";
    case RecordType::reader_withdrawn:
      return "reports that it no longer serves " + reader_words(record) + ": " +
             journal::sentence_of(static_cast<abi::Withdrawal>(argument(record, "why")));
    case RecordType::reader_served_again:
      return "reports that it serves " + reader_words(record) + " again";
    case RecordType::reader_mute:
      return "has no doorbell (wait set " + number_of(record, "wait_set") + ", uid " +
             number_of(record, "uid") + "), it finds messages only by polling";
  }
  return "unknown";
}

bool passes(const JournalRecord& record, const JournalFilter& filter) {
  if (!filter.topic.empty() && (is_damaged(record) || text_of(record.topic) != filter.topic))
    return false;
  if (filter.process.empty()) return true;
  if (is_damaged(record)) return false;
  for (const wire::JournalProcess* const process : {&record.process, &record.receiver}) {
    if (process->pid != 0 && filter.process == std::to_string(process->pid)) return true;
    if (text_of(process->name) == filter.process) return true;
  }
  return false;
}

}  // namespace agnocast::ctl
