// SPDX-License-Identifier: Apache-2.0

#include <client/static_text.hpp>

#include <cstddef>
#include <mutex>
#include <new>
#include <set>

namespace agnocast {
namespace {

// A program that asks for wrong names in a loop must not grow by it: 1000 × a few hundred bytes.
constexpr std::size_t text_count_max = 1000;
constexpr std::size_t text_bytes_max = 512;

struct Texts {
  std::mutex mutex;
  std::set<std::string> all;
};

}  // namespace

const char* static_text(const std::string& text, const char* otherwise) noexcept try {
  static Texts* const texts = new Texts;  // immortal, as what it hands out
  const std::lock_guard lock(texts->mutex);
  if (const auto known = texts->all.find(text); known != texts->all.end()) return known->c_str();
  if (texts->all.size() == text_count_max || text.size() > text_bytes_max) return otherwise;
  return texts->all.insert(text).first->c_str();
} catch (const std::bad_alloc&) {
  return otherwise;
}

}  // namespace agnocast
