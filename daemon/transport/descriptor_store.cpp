// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/descriptor_store.hpp>

#include <daemon/state/steps.hpp>

#include <fcntl.h>
#include <poll.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace agnocast::daemon {
namespace {

// How long the manager may take.
constexpr std::uint64_t barrier_patience_us = 5'000'000;

std::size_t limit_of_manager() noexcept {
  const char* const text = std::getenv("FDSTORE");
  if (text == nullptr) return SIZE_MAX;
  std::size_t limit = 0;
  const char* const end = text + std::strlen(text);
  const auto parsed = std::from_chars(text, end, limit);
  return parsed.ec == std::errc() && parsed.ptr == end && limit > 0 ? limit : SIZE_MAX;
}

// systemd announces with $FDSTORE that it keeps descriptors since version 254; before, only a try
// can tell: it closes descriptors that it does not keep.
bool manager_keeps_anything() noexcept {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC | O_NONBLOCK) != 0) return true;
  const UniqueFd ours(ends[0]);
  UniqueFd given(ends[1]);
  const int fds[] = {given.get()};
  const char* const name = "FDNAME=agnocastd-probe";
  if (::sd_pid_notify_with_fds(0, 0, (std::string("FDSTORE=1\nFDPOLL=0\n") + name).c_str(), fds,
                               1) <= 0)
    return false;
  given.reset();
  wait_for_manager();
  pollfd other_end{ours.get(), 0, 0};
  const bool is_closed = ::poll(&other_end, 1, 0) == 1 && (other_end.revents & POLLHUP) != 0;
  if (!is_closed) notify(std::string("FDSTOREREMOVE=1\n") + name);
  return !is_closed;
}

std::string indexed(char kind, ClientIndex client) { return kind + std::to_string(number(client)); }

}  // namespace

Result<std::vector<HandedIn>> receive_descriptors() {
  char** names = nullptr;
  const int count = ::sd_listen_fds_with_names(1, &names);
  if (count < 0) return fail(Errc::os_failure, "receiving stored descriptors", -count);
  std::vector<HandedIn> all;
  for (int i = 0; i < count; ++i) {
    all.push_back({names[i], UniqueFd(SD_LISTEN_FDS_START + i)});
    std::free(names[i]);
  }
  std::free(names);
  return all;
}

Result<DescriptorStore> DescriptorStore::of_nobody() {
  auto handed_in = receive_descriptors();
  if (!handed_in) return tl::unexpected(handed_in.error());
  DescriptorStore store;
  for (HandedIn& one : *handed_in) {
    if (one.name == passed_socket_name) store.passed_.push_back(std::move(one.fd));
  }
  return store;
}

Result<DescriptorStore> DescriptorStore::of_manager() {
  const char* const socket = std::getenv("NOTIFY_SOCKET");
  if (socket == nullptr || *socket == '\0')
    return fail(Errc::invalid_argument, "no service manager is there to keep descriptors");
  DescriptorStore store;
  store.keeps_ = true;
  store.kept_count_max_ = limit_of_manager();
  auto handed_in = receive_descriptors();
  if (!handed_in) return tl::unexpected(handed_in.error());
  for (HandedIn& one : *handed_in) {
    if (one.name == passed_socket_name) {
      store.passed_.push_back(std::move(one.fd));
    } else {
      store.kept_.insert(one.name);
      store.former_[one.name] = std::move(one.fd);
    }
  }
  const bool says_so = store.kept_count_max_ != SIZE_MAX || !store.kept_.empty();
  store.is_refused_ = !says_so && !manager_keeps_anything();
  store.keeps_ = !store.is_refused_;
  return store;
}

UniqueFd DescriptorStore::take(const std::string& name) {
  const auto found = former_.find(name);
  if (found == former_.end()) return UniqueFd();
  UniqueFd fd = std::move(found->second);
  former_.erase(found);
  return fd;
}

std::vector<std::string> DescriptorStore::left_over() const {
  std::vector<std::string> names;
  for (const auto& [name, fd] : former_) names.push_back(name);
  return names;
}

std::size_t DescriptorStore::remove_left_over() {
  const std::size_t count = former_.size();
  if (count == 0) return 0;
  for (const std::string& name : left_over()) remove(name);
  former_.clear();
  wait_for_manager();
  return count;
}

Result<void> DescriptorStore::put(const std::string& name, int fd) {
  if (!keeps_) return {};
  if (kept_.size() >= kept_count_max_)
    return fail_with(Errc::limit_reached, "FileDescriptorStoreMax is " +
                                              std::to_string(kept_count_max_) +
                                              ", as many descriptors are kept");
  // FDPOLL=0: a manager that polls would drop a pidfd when its process ends.
  const std::string state = "FDSTORE=1\nFDPOLL=0\nFDNAME=" + name;
  const int fds[] = {fd};
  AGNOCAST_CRASH_POINT(B_keep);
  const int status = ::sd_pid_notify_with_fds(0, 0, state.c_str(), fds, 1);
  if (status <= 0) return fail(Errc::os_failure, "storing a descriptor", -status);
  AGNOCAST_CRASH_POINT(B_kept);
  kept_.insert(name);
  return {};
}

void DescriptorStore::remove(const std::string& name) noexcept {
  if (kept_.erase(name) == 0) return;
  AGNOCAST_CRASH_POINT(B_drop);
  notify("FDSTOREREMOVE=1\nFDNAME=" + name);
  AGNOCAST_CRASH_POINT(B_dropped);
}

std::string DescriptorStore::region(ClientIndex client) { return indexed('r', client); }
std::string DescriptorStore::process(ClientIndex client) { return indexed('p', client); }
std::string DescriptorStore::window(ClientIndex client, std::uint64_t window) {
  return indexed('w', client) + '.' + std::to_string(window);
}
std::string DescriptorStore::eventfd(ClientIndex client, std::uint64_t wait_set) {
  return indexed('e', client) + '.' + std::to_string(wait_set);
}

void notify(const std::string& state) noexcept { static_cast<void>(::sd_notify(0, state.c_str())); }

void wait_for_manager() noexcept { static_cast<void>(::sd_notify_barrier(0, barrier_patience_us)); }

}  // namespace agnocast::daemon
