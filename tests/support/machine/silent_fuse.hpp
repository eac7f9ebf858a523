// SPDX-License-Identifier: Apache-2.0
//
// SilentFuse: a file system that answers as little as possible. Its users block until this ends.
//
// The whole file system is its root: either a file that can be opened, and whose close() waits for
// ever for the answer to FUSE_FLUSH, even after SIGKILL; or a directory in which every lookup
// waits for ever. If it keeps writes, closing the last descriptor of a file also waits, for the
// answer to FUSE_WRITE, even where the descriptor never had a number. Reading a file of `bytes`
// bytes waits as well. Needs root and /dev/fuse; see made().
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <linux/fuse.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <thread>
#include <utility>

namespace agnocast::test {

class SilentFuse {
 public:
  /// Mounts over `path`: S_IFREG over a file, S_IFDIR over a directory.
  SilentFuse(std::string path, mode_t kind, bool keeps_writes = false, std::uint64_t bytes = 0)
      : path_(std::move(path)),
        kind_(kind),
        keeps_writes_(keeps_writes),
        bytes_(bytes),
        device_(::open("/dev/fuse", O_RDWR | O_CLOEXEC)) {
    if (!device_) return;
    std::array<char, 128> options{};
    std::snprintf(options.data(), options.size(),
                  "fd=%d,rootmode=%o,user_id=0,group_id=0,allow_other", device_.get(), kind_);
    made_ = ::mount("silent", path_.c_str(), "fuse", MS_NOSUID | MS_NODEV, options.data()) == 0;
    if (made_) server_ = std::thread([this] { serve(); });
  }
  /// Ends all waits.
  ~SilentFuse() { end(); }
  SilentFuse(const SilentFuse&) = delete;
  SilentFuse& operator=(const SilentFuse&) = delete;

  bool made() const noexcept { return made_; }
  /// Returns the number of unanswered requests.
  unsigned unanswered() const noexcept { return unanswered_.load(); }
  void end() {
    if (!std::exchange(made_, false)) return;
    ::umount2(path_.c_str(), MNT_FORCE);  // ends all requests, and the server's read
    ::umount2(path_.c_str(), MNT_DETACH);
    stops_ = true;
    server_.join();
    device_.reset();
  }

 private:
  template <class Body>
  void answer(std::uint64_t unique, const Body& body) {
    fuse_out_header header{};
    header.len = sizeof header + sizeof body;
    header.unique = unique;
    iovec parts[] = {{&header, sizeof header}, {const_cast<Body*>(&body), sizeof body}};
    static_cast<void>(!::writev(device_.get(), parts, 2));
  }
  void serve() {
    ::fcntl(device_.get(), F_SETFL, O_NONBLOCK);
    std::array<char, 1 << 16> request;
    while (!stops_) {
      const ssize_t bytes = ::read(device_.get(), request.data(), request.size());
      if (bytes < static_cast<ssize_t>(sizeof(fuse_in_header))) {
        if (bytes < 0 && errno == ENODEV) return;  // unmounted
        ::usleep(1'000);
        continue;
      }
      fuse_in_header header{};
      std::memcpy(&header, request.data(), sizeof header);
      if (header.opcode == FUSE_INIT) {
        fuse_init_in asked{};
        std::memcpy(&asked, request.data() + sizeof header, sizeof(std::uint32_t) * 4);
        fuse_init_out init{};
        init.major = FUSE_KERNEL_VERSION;
        init.minor = std::min<std::uint32_t>(asked.minor, FUSE_KERNEL_MINOR_VERSION);
        init.max_write = 4096;
        if (keeps_writes_) init.flags = FUSE_WRITEBACK_CACHE;
        answer(header.unique, init);
      } else if (header.opcode == FUSE_GETATTR) {
        fuse_attr_out out{};
        out.attr_valid = 3600;
        out.attr.ino = FUSE_ROOT_ID;
        out.attr.mode = kind_ | 0777;
        out.attr.nlink = 1;
        out.attr.size = bytes_;
        answer(header.unique, out);
      } else if (header.opcode == FUSE_OPEN) {
        fuse_open_out out{};
        // Otherwise an open would wait for the written data.
        if (keeps_writes_) out.open_flags = FOPEN_KEEP_CACHE;
        answer(header.unique, out);
      } else if (header.opcode == FUSE_GETXATTR) {  // before the first write
        fuse_out_header none{sizeof none, -ENOSYS, header.unique};
        static_cast<void>(!::write(device_.get(), &none, sizeof none));
      } else {
        ++unanswered_;
      }
    }
  }

  std::string path_;
  mode_t kind_;
  bool keeps_writes_;
  std::uint64_t bytes_;
  UniqueFd device_;
  bool made_ = false;
  std::atomic<bool> stops_ = false;
  std::atomic<unsigned> unanswered_ = 0;
  std::thread server_;
};

}  // namespace agnocast::test
