// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/status_socket.hpp>

#include <base/clock.hpp>
#include <base/descriptors/closing.hpp>
#include <base/sockets/packet_socket.hpp>
#include <base/sockets/socket_file.hpp>
#include <base/sockets/socket_path.hpp>
#include <base/sockets/unix_address.hpp>

#include <fcntl.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bridge {
namespace {

constexpr std::size_t reader_count_max = 16;
constexpr std::uint64_t patience_ms = 5'000;
// Readers that ask more often get the same answer again.
constexpr std::uint64_t answer_interval_ms = 50;
// A reader that has taken nothing for this long loses its place to a waiting one.
constexpr std::uint64_t turn_ms = 100;
// The pause after a failure: accept() fails at once without free descriptors as long as a client
// waits, and so does a round of the loop without memory.
constexpr std::uint64_t retry_interval_ms = 100;

struct ReaderOf {
  UniqueFd fd;
  std::shared_ptr<const std::string> text;
  std::size_t sent = 0;
  std::uint64_t end_ms = 0;
  std::uint64_t moved_ms = 0;  // when it last took data

  /// Sends as much as fits; returns whether there is more to send.
  bool send() {
    while (sent < text->size()) {
      const ssize_t count =
          ::send(fd.get(), text->data() + sent, text->size() - sent, MSG_DONTWAIT | MSG_NOSIGNAL);
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) return errno == EAGAIN;
      sent += static_cast<std::size_t>(count);
      moved_ms = monotonic_ms();
    }
    return false;
  }
};

// Before Linux 6.16 a reader may send descriptors; they are closed with its connection, which
// takes as long as their owner likes (base/descriptors/closing.hpp). Separate threads wait for
// that; new readers are served until there are too many such threads.
class Closings {
 public:
  bool is_full() const { return count_->load(std::memory_order_relaxed) >= reader_count_max; }
  void close(UniqueFd fd) {
    if (!fd || refuses_descriptors(fd.get())) return;
    ::shutdown(fd.get(), SHUT_RDWR);
    count_->fetch_add(1, std::memory_order_relaxed);
    try {
      std::thread([count = count_, number = fd.get()] {
        UniqueFd one(number);
        close_by_ending_thread({&one, 1});
        count->fetch_sub(1, std::memory_order_relaxed);
      }).detach();
    } catch (const std::system_error&) {  // no thread available: it stays open and counts
    }
    static_cast<void>(fd.release());
  }

 private:
  std::shared_ptr<std::atomic<std::size_t>> count_ = std::make_shared<std::atomic<std::size_t>>(0);
};

StatusSocket::Failure failure(const std::string& what) {
  return {false, what + ": " + std::strerror(errno)};
}

}  // namespace

tl::expected<std::unique_ptr<StatusSocket>, StatusSocket::Failure> StatusSocket::take(
    const std::string& path) {
  if (const auto checked = check_socket_directory(directory_of(path)); !checked)
    return tl::unexpected(Failure{false, checked.error().what});
  std::unique_ptr<StatusSocket> made(new StatusSocket);
  auto lock = open_lock_file(path + ".lock");
  if (!lock && lock.error().code == Errc::permission_denied)
    return tl::unexpected(Failure{false, path + ".lock: " + lock.error().what});
  if (!lock) {
    errno = lock.error().os_errno;
    return tl::unexpected(failure(path + ".lock"));
  }
  made->lock_ = std::move(*lock);
  if (::flock(made->lock_.get(), LOCK_EX | LOCK_NB) != 0)
    return tl::unexpected(errno == EWOULDBLOCK ? Failure{true, path + ".lock is locked"}
                                               : failure("flock"));
  made->path_ = path;
  return made;
}

tl::expected<void, StatusSocket::Failure> StatusSocket::listen(
    std::function<std::string()> answer) {
  const auto address = unix_address(path_);
  if (!address) return tl::unexpected(Failure{false, address.error().what});
  ::unlink(path_.c_str());
  socket_.reset(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  stop_.reset(::eventfd(0, EFD_CLOEXEC));
  if (!socket_ || !stop_ || ::bind(socket_.get(), address->get(), UnixAddress::size()) != 0 ||
      !set_mode_of_socket(path_, 0660) || ::listen(socket_.get(), SOMAXCONN) != 0)
    return tl::unexpected(failure(path_));
  refuse_descriptors(socket_.get());
  answer_ = std::move(answer);
  thread_ = std::thread([this] { serve(); });
  return {};
}

StatusSocket::~StatusSocket() {
  if (thread_.joinable()) {
    (void)::eventfd_write(stop_.get(), 1);
    thread_.join();
  }
  if (socket_) ::unlink(path_.c_str());
  // Clients that wait in the accept queue are closed with the socket.
  if (socket_ && !refuses_descriptors(socket_.get())) close_without_waiting(std::move(socket_));
}

/// Long because one loop waits for three things (the end, readers, the next client) and what each
/// of them changes is when the others are looked at.
void StatusSocket::serve() {
  std::vector<ReaderOf> readers;
  Closings closings;
  std::shared_ptr<const std::string> latest;
  std::uint64_t made_ms = 0;
  std::uint64_t accept_ms = 0;  // accept no one before; clients wait in the socket's queue
  const auto goes_on = [&] {
    std::uint64_t now = monotonic_ms();
    int wait_ms = -1;
    const auto wake_at = [&](std::uint64_t then) {
      const int left = static_cast<int>(then > now ? then - now : 0);
      wait_ms = wait_ms < 0 ? left : std::min(wait_ms, left);
    };
    std::vector<pollfd> polled{{stop_.get(), POLLIN, 0}};
    for (const ReaderOf& reader : readers) {
      polled.push_back({reader.fd.get(), POLLOUT, 0});
      wake_at(reader.end_ms);
    }
    if (accept_ms <= now) {
      polled.push_back({socket_.get(), POLLIN, 0});
    } else {
      wake_at(accept_ms);
    }
    if (::poll(polled.data(), polled.size(), wait_ms) < 0 && errno != EINTR) return false;
    if (polled[0].revents != 0) return false;
    now = monotonic_ms();
    for (std::size_t i = 0; i < readers.size(); ++i) {
      const bool is_ready = polled[i + 1].revents != 0;
      if ((is_ready && !readers[i].send()) || readers[i].end_ms <= now)
        closings.close(std::move(readers[i].fd));
    }
    std::erase_if(readers, [](const ReaderOf& reader) { return !reader.fd; });
    if (polled.back().fd != socket_.get() || polled.back().revents == 0) return true;
    if (readers.size() >= reader_count_max) {
      const auto slowest = std::min_element(
          readers.begin(), readers.end(),
          [](const ReaderOf& a, const ReaderOf& b) { return a.moved_ms < b.moved_ms; });
      accept_ms = slowest->moved_ms + turn_ms;
      if (accept_ms > now) return true;
      closings.close(std::move(slowest->fd));
      readers.erase(slowest);
    }
    if (closings.is_full()) {
      accept_ms = now + retry_interval_ms;
      return true;
    }
    UniqueFd fd(::accept4(socket_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (!fd) {
      if (errno != EAGAIN && errno != EINTR && errno != ECONNABORTED)
        accept_ms = now + retry_interval_ms;
      return true;
    }
    if (latest == nullptr || now - made_ms >= answer_interval_ms) {
      latest = std::make_shared<const std::string>(answer_());
      made_ms = monotonic_ms();
    }
    now = monotonic_ms();
    ReaderOf reader{std::move(fd), latest, 0, now + patience_ms, now};
    if (reader.send()) {
      readers.push_back(std::move(reader));
    } else {
      closings.close(std::move(reader.fd));
    }
    return true;
  };
  for (bool ends = false; !ends;) {
    try {
      ends = !goes_on();
    } catch (const std::exception&) {
      // No memory. The client that has just asked gets no answer and may ask again.
      pollfd stop{stop_.get(), POLLIN, 0};
      ends = ::poll(&stop, 1, static_cast<int>(retry_interval_ms)) > 0;
    }
  }
  for (ReaderOf& reader : readers) closings.close(std::move(reader.fd));
}

std::string choose_status_path(const std::string& named, std::uint32_t domain) {
  if (!named.empty()) return named;
  const std::string name = "/bridge-" + std::to_string(domain) + ".sock";
  // systemd may list several directories, separated by colons.
  if (const char* const made = std::getenv("RUNTIME_DIRECTORY"); made != nullptr && *made == '/')
    return std::string(made).substr(0, std::string(made).find(':')) + name;
  const std::string daemon = socket_path();
  return daemon.substr(0, std::min(daemon.rfind('/'), daemon.size())) + name;
}

}  // namespace agnocast::bridge
