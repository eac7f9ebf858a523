// SPDX-License-Identifier: Apache-2.0
//
// Anonymous memory for a registry: redo log, tables and board, all zero like the daemon's memfds,
// and shared like them, so that pages can be given back.
#pragma once

#include <daemon/state/registry.hpp>

#include <sys/mman.h>

#include <cstdlib>

namespace agnocast::test {

class RegistryMemory {
 public:
  RegistryMemory() {
    base_ = static_cast<std::byte*>(::mmap(nullptr, bytes, PROT_READ | PROT_WRITE,
                                           MAP_SHARED | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0));
    if (base_ == MAP_FAILED) std::abort();
  }
  ~RegistryMemory() { ::munmap(base_, bytes); }
  RegistryMemory(const RegistryMemory&) = delete;
  RegistryMemory& operator=(const RegistryMemory&) = delete;

  daemon::Registry::Memory parts() const {
    return {base_, base_ + journal::RedoLog::bytes,
            base_ + journal::RedoLog::bytes + daemon::tables_bytes};
  }
  std::byte* board() const { return parts().board; }

 private:
  static constexpr std::uint64_t bytes =
      journal::RedoLog::bytes + daemon::tables_bytes + abi::board_bytes;
  std::byte* base_;
};

}  // namespace agnocast::test
