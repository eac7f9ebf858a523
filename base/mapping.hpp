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
  /// somebody else's memory.
  [[nodiscard]] static Result<Mapping> map(int fd, std::uint64_t bytes, Access access) noexcept;
  /// Addresses without memory (PROT_NONE). At `address` exactly if it is not zero; EEXIST when
  /// something is in the way.
  [[nodiscard]] static Result<Mapping> reserve(std::uint64_t address, std::uint64_t bytes) noexcept;

  std::byte* base() const noexcept { return base_; }
  std::uint64_t bytes() const noexcept { return bytes_; }
  explicit operator bool() const noexcept { return base_ != nullptr; }
  void reset() noexcept;

 private:
  Mapping(std::byte* base, std::uint64_t bytes) noexcept : base_(base), bytes_(bytes) {}

  std::byte* base_ = nullptr;
  std::uint64_t bytes_ = 0;
};

}  // namespace agnocast
