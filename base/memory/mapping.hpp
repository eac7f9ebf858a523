// SPDX-License-Identifier: Apache-2.0
//
// Mapping: owns a range of addresses, mapped by map() or map_private(), or reserved by reserve().
#pragma once

#include <agnocast/result.hpp>

#include <cstddef>
#include <cstdint>
#include <utility>

namespace agnocast {

class Mapping {
 public:
  enum class Access : std::uint8_t { read, read_write };

  Mapping() = default;
  Mapping(Mapping&& other) noexcept
      : base_(std::exchange(other.base_, nullptr)), bytes_(std::exchange(other.bytes_, 0)) {}
  Mapping& operator=(Mapping&& other) noexcept {
    if (this != &other) {
      reset();
      base_ = std::exchange(other.base_, nullptr);
      bytes_ = std::exchange(other.bytes_, 0);
    }
    return *this;
  }
  ~Mapping() { reset(); }

  /// Maps `bytes` of `fd` shared, anywhere. Excludes a read mapping, which is another process's
  /// memory, from core dumps. Errors: os_failure, address_limit, lock_limit.
  [[nodiscard]] static Result<Mapping> map(int fd, std::uint64_t bytes, Access access) noexcept;
  /// Maps private zeroed memory, anywhere. Errors: os_failure, address_limit, lock_limit.
  [[nodiscard]] static Result<Mapping> map_private(std::uint64_t bytes) noexcept;
  /// Reserves addresses without memory (PROT_NONE). At `address` exactly if it is not zero;
  /// EEXIST if that is occupied. Reserved addresses do not count against RLIMIT_MEMLOCK, even in
  /// a process that has called mlockall(MCL_FUTURE). Errors: os_failure, address_limit,
  /// lock_limit.
  [[nodiscard]] static Result<Mapping> reserve(std::uint64_t address, std::uint64_t bytes) noexcept;
  /// Replaces any mappings in [at, at + bytes), which must belong to the caller, by reserved
  /// addresses.
  static void cover(std::byte* at, std::uint64_t bytes) noexcept;

  std::byte* base() const noexcept { return base_; }
  std::uint64_t bytes() const noexcept { return bytes_; }
  explicit operator bool() const noexcept { return base_ != nullptr; }
  void reset() noexcept;

 private:
  Mapping(std::byte* base, std::uint64_t bytes) noexcept : base_(base), bytes_(bytes) {}

  std::byte* base_ = nullptr;
  std::uint64_t bytes_ = 0;
};

/// Returns whether this process has called mlockall(MCL_FUTURE): new mappings count as locked.
/// Reads /proc twice.
bool locks_new_mappings() noexcept;

/// Explains EAGAIN of mmap for `bytes`: the limit of locked memory, its use, and the need.
Failure lock_refusal(std::uint64_t bytes) noexcept;
/// Explains ENOMEM: the limit of addresses if there is one (address_limit), else os_failure.
Failure no_memory(std::uint64_t bytes, const char* what) noexcept;

}  // namespace agnocast
