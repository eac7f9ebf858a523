// SPDX-License-Identifier: Apache-2.0
//
// Mapping: owner of a range of addresses. Made by map() anywhere, or by reserve() plus map_at()
// inside a reservation.
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

  /// Maps `bytes` of `fd` shared, anywhere. A read mapping is left out of core dumps: it is
  /// somebody else's memory. Errors: os_failure, address_limit, lock_limit.
  [[nodiscard]] static Result<Mapping> map(int fd, std::uint64_t bytes, Access access) noexcept;
  /// Private zeroed memory, anywhere. Errors: os_failure, address_limit, lock_limit.
  [[nodiscard]] static Result<Mapping> map_private(std::uint64_t bytes) noexcept;
  /// Addresses without memory (PROT_NONE). At `address` exactly if it is not zero; EEXIST when
  /// something is in the way. Reserved addresses do not count against RLIMIT_MEMLOCK, also in a
  /// process that has called mlockall(MCL_FUTURE). Errors: os_failure, address_limit, lock_limit.
  [[nodiscard]] static Result<Mapping> reserve(std::uint64_t address, std::uint64_t bytes) noexcept;
  /// Puts reserved addresses in place of whatever lies at [at, at + bytes), which has to be the
  /// caller's.
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

/// Whether this process has said mlockall(MCL_FUTURE): all of what is mapped counts as locked. Reads /proc twice.
bool locks_new_mappings() noexcept;

/// Why mmap answered EAGAIN to `bytes`: the limit of locked memory, how much of it is used, what is
/// needed.
Failure lock_refusal(std::uint64_t bytes) noexcept;
/// Why it answered ENOMEM: the limit of addresses if there is one (address_limit), else os_failure.
Failure no_memory(std::uint64_t bytes, const char* what) noexcept;

}  // namespace agnocast
