// SPDX-License-Identifier: Apache-2.0

#include <client/upkeep/thread_report.hpp>

#include <memory>
#include <vector>

namespace agnocast {

namespace wire = abi::wire;

namespace {

void tell_group(Connection& connection, const ThreadRegister::Group& group) {
  wire::CallbackGroup body{};
  body.executor = group.executor;
  body.group = group.group;
  body.is_there = 1;
  body.reentrant = group.type == CallbackGroupType::Reentrant ? 1 : 0;
  // Longer names are cut: they are for people and patterns.
  write_name(body.node, std::string_view(group.node).substr(0, wire::name_bytes - 1));
  write_name(body.name, std::string_view(group.name).substr(0, wire::name_bytes - 1));
  connection.post(wire::Opcode::callback_group, body);
}

void tell_thread(Connection& connection, const ThreadRegister::Thread& thread, bool is_there) {
  wire::CallbackThread body{};
  body.executor = thread.executor;
  body.thread = thread.thread;
  body.is_there = is_there ? 1 : 0;
  connection.post(wire::Opcode::callback_thread, body);
}

}  // namespace

void ThreadReport::tell(Connection& connection) {
  const ThreadRegister& known = ThreadRegister::instance();
  const std::uint64_t version = known.version();
  if (version == reported_version_) return;
  std::vector<std::shared_ptr<const ThreadRegister::Group>> groups;
  std::vector<ThreadRegister::Thread> threads;
  known.copy(groups, threads);

  std::set<GroupKey> present_groups;
  for (const auto& group : groups) present_groups.insert({group->executor, group->group});
  std::set<ThreadRegister::Thread> present_threads(threads.begin(), threads.end());

  // Ends first: a number of a thread may have a new owner. Threads last: the daemon chooses their
  // rule by the groups.
  for (const ThreadRegister::Thread& thread : threads_) {
    if (!present_threads.contains(thread)) tell_thread(connection, thread, false);
  }
  for (const auto& [executor, group] : groups_) {
    if (present_groups.contains({executor, group})) continue;
    wire::CallbackGroup body{};
    body.executor = executor;
    body.group = group;
    connection.post(wire::Opcode::callback_group, body);
  }
  for (const auto& group : groups) {
    if (!groups_.contains({group->executor, group->group})) tell_group(connection, *group);
  }
  for (const ThreadRegister::Thread& thread : threads) {
    if (!threads_.contains(thread)) tell_thread(connection, thread, true);
  }
  groups_ = std::move(present_groups);
  threads_ = std::move(present_threads);
  reported_version_ = version;
}

void ThreadReport::forget() noexcept {
  reported_version_ = 0;
  groups_.clear();
  threads_.clear();
}

}  // namespace agnocast
