// SPDX-License-Identifier: Apache-2.0
//
// Texts of the error table and the exception that carries them.

#include <agnocast/error.hpp>

#include <string>

namespace agnocast {
namespace {

struct Row {
  Errc code;
  const char* sentence;
  const char* remedy;
};

constexpr Row rows[] = {{Errc::ok, "no error", ""},
#define AGNOCAST_ERROR_ROW(name, sentence, remedy) {Errc::name, sentence, remedy},
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

std::string text_of(const Failure& failure) {
  std::string text = failure.what;
  if (failure.os_errno != 0) {
    text += " (";
    text += std::generic_category().message(failure.os_errno);
    text += ")";
  }
  return text;
}

}  // namespace

const char* sentence_of(Errc code) noexcept {
  const Row* row = find(code);
  return row != nullptr ? row->sentence : "unknown error";
}

const char* remedy_of(Errc code) noexcept {
  const Row* row = find(code);
  return row != nullptr ? row->remedy : "";
}

const std::error_category& error_category() noexcept {
  static const Category category;
  return category;
}

Error::Error(const Failure& failure)
    : std::system_error(make_error_code(failure.code), text_of(failure)), failure_(failure) {}

}  // namespace agnocast
