// SPDX-License-Identifier: Apache-2.0
//
// Texts of the error table and the exception that carries them.

#include <agnocast/error.hpp>
#include <agnocast/exceptions.hpp>

#include <atomic>
#include <cstring>
#include <string>

namespace agnocast {
namespace {

struct Row {
  Errc code;
  const char* word;
  const char* sentence;
  const char* cause;
  const char* remedy;
};

constexpr Row rows[] = {{Errc::ok, "ok", "no error", "", ""},
#define AGNOCAST_ERROR_ROW(name, sentence, cause, remedy) \
  {Errc::name, #name, sentence, cause, remedy},
                        AGNOCAST_ERROR_TABLE(AGNOCAST_ERROR_ROW)
#undef AGNOCAST_ERROR_ROW
};

const Row* find(Errc code) noexcept {
  for (const Row& row : rows) {
    if (row.code == code) return &row;
  }
  return nullptr;
}

class Category final : public std::error_category {
  const char* name() const noexcept override { return "agnocast"; }
  std::string message(int code) const override { return sentence_of(static_cast<Errc>(code)); }
};

// The detail of the calling thread's last failure that had one. Numbers are unique in a process,
// so a failure cannot find the text of another one.
struct LastDetail {
  std::uint64_t number = 0;
  char text[detail_bytes_max] = "";
};
thread_local LastDetail last_detail;
std::atomic<std::uint64_t> last_number{0};

}  // namespace

const char* sentence_of(Errc code) noexcept {
  const Row* row = find(code);
  return row != nullptr ? row->sentence : "unknown error";
}

const char* cause_of(Errc code) noexcept {
  const Row* row = find(code);
  return row != nullptr ? row->cause : "";
}

const char* remedy_of(Errc code) noexcept {
  const Row* row = find(code);
  return row != nullptr ? row->remedy : "";
}

const char* word_of(Errc code) noexcept {
  const Row* row = find(code);
  return row != nullptr ? row->word : "?";
}

const std::error_category& error_category() noexcept {
  static const Category category;
  return category;
}

const char* detail_of(const Failure& failure) noexcept {
  return failure.detail != 0 && failure.detail == last_detail.number ? last_detail.text : "";
}

std::string text_of(const Failure& failure) {
  std::string text = sentence_of(failure.code);
  const char* const detail = detail_of(failure);
  for (const std::string& why :
       {std::string(*detail != '\0' ? detail : failure.what),
        failure.os_errno != 0 ? std::generic_category().message(failure.os_errno) : ""}) {
    if (!why.empty()) text += ": " + why;
  }
  return text;
}

Failure failure_with(Errc code, const char* detail, int os_errno) noexcept {
  // `detail` may be the stored text of an earlier failure: memmove allows that.
  const std::size_t length = ::strnlen(detail, detail_bytes_max - 1);
  std::memmove(last_detail.text, detail, length);
  last_detail.text[length] = '\0';
  last_detail.number = last_number.fetch_add(1, std::memory_order_relaxed) + 1;
  return {code, os_errno, "", last_detail.number};
}

Error::Error(const Failure& failure)
    : std::system_error(make_error_code(failure.code)),
      failure_(failure),
      text_(std::make_shared<const std::string>(text_of(failure))) {}

void detail::throw_error(const Failure& failure) { throw Error(failure); }
void detail::throw_bad_array_new_length() { throw std::bad_array_new_length(); }

}  // namespace agnocast
