// SPDX-License-Identifier: Apache-2.0

#include <daemon/doorbells.hpp>

#include <base/step.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <memory>
#include <set>

namespace agnocast::daemon {
namespace {

// The receiver owns its descriptors; a packet needs its own.
Result<SharedFd> duplicate(int fd) {
  UniqueFd copy(::fcntl(fd, F_DUPFD_CLOEXEC, 0));
  if (!copy) return fail(Errc::os_failure, "duplicating a descriptor", errno);
  return share(std::move(copy));
}

}  // namespace

Result<std::vector<SharedFd>> Doorbells::open(ClientIndex client, std::uint64_t executor) {
  const Key key{number(client), executor};
  if (const auto found = bells_.find(key); found != bells_.end()) {
    if (SharedFd datagram = found->second.given.lock())
      return std::vector<SharedFd>{found->second.eventfd, std::move(datagram)};
    close(client, executor);
  }
  const std::string name = name_of(key);
  AGNOCAST_CRASH_POINT(B_bell_bind);
  auto receiver = make_doorbell(directory_, name);
  if (!receiver) return tl::unexpected(receiver.error());
  auto sender = connect_doorbell(directory_, name);
  if (!sender) return tl::unexpected(sender.error());
  auto eventfd = duplicate(receiver->eventfd());
  if (!eventfd) return tl::unexpected(eventfd.error());
  auto datagram = duplicate(receiver->datagram_fd());
  if (!datagram) return tl::unexpected(datagram.error());
  if (auto kept = store_.put(DescriptorStore::eventfd(client, executor), (*eventfd)->get()); !kept)
    return tl::unexpected(kept.error());
  bells_[key] = Bell{*eventfd, *datagram, Doorbell(std::move(*sender))};
  return std::vector<SharedFd>{*eventfd, *datagram};
}

void Doorbells::restore(ClientIndex client, std::uint64_t executor) {
  const Key key{number(client), executor};
  UniqueFd eventfd = store_.take(DescriptorStore::eventfd(client, executor));
  if (!eventfd) return;  // its process opens it again
  auto sender = connect_doorbell(directory_, name_of(key));
  bells_[key] =
      Bell{share(std::move(eventfd)), {}, sender ? Doorbell(std::move(*sender)) : Doorbell()};
}

void Doorbells::clear_strangers() noexcept {
  const std::unique_ptr<DIR, int (*)(DIR*)> entries(::opendir(directory_.c_str()), &::closedir);
  if (entries == nullptr) return;
  std::set<std::string> known;
  for (const auto& [key, bell] : bells_) known.insert(name_of(key));
  while (const dirent* const entry = ::readdir(entries.get())) {
    if (entry->d_name[0] != '.' && known.count(entry->d_name) == 0)
      ::unlinkat(::dirfd(entries.get()), entry->d_name, 0);
  }
}

std::vector<SharedFd> Doorbells::for_publisher(ClientIndex client, std::uint64_t executor,
                                               bool same_user) {
  const Key key{number(client), executor};
  const auto found = bells_.find(key);
  if (found == bells_.end()) return {};
  auto sender = connect_doorbell(directory_, name_of(key));
  if (!sender) return {};
  std::vector<SharedFd> fds;
  if (same_user) fds.push_back(found->second.eventfd);
  fds.push_back(share(std::move(*sender)));
  return fds;
}

void Doorbells::ring(ClientIndex client, std::uint64_t executor) noexcept {
  const auto found = bells_.find({number(client), executor});
  if (found != bells_.end()) found->second.own.ring();
}

void Doorbells::ring_all() noexcept {
  for (auto& [key, bell] : bells_) bell.own.ring();
}

void Doorbells::close(ClientIndex client, std::uint64_t executor) noexcept {
  const Key key{number(client), executor};
  if (bells_.erase(key) == 0) return;
  ::unlink((directory_ + "/" + name_of(key)).c_str());
  store_.remove(DescriptorStore::eventfd(client, executor));
}

void Doorbells::close_client(ClientIndex client) noexcept {
  const auto begin = bells_.lower_bound({number(client), 0});
  const auto end = bells_.lower_bound({number(client) + 1, 0});
  for (auto at = begin; at != end; ++at) {
    AGNOCAST_CRASH_POINT(B_bell_remove);
    ::unlink((directory_ + "/" + name_of(at->first)).c_str());
    store_.remove(DescriptorStore::eventfd(client, at->first.second));
  }
  bells_.erase(begin, end);
}

}  // namespace agnocast::daemon
