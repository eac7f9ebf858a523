// SPDX-License-Identifier: Apache-2.0
//
// Services for tests, and their messages: they allocate by themselves, so that the tests run under
// sanitizers too.
#pragma once

#include <agnocast/agnocast.hpp>

#include <cstdint>

namespace agnocast::test {

/// The response has `count` times `value`.
struct Repeat {
  struct Request : SharedMessage {
    std::uint64_t value = 0;
    std::uint64_t count = 0;
    SharedString note;  // the response repeats it
  };
  struct Response : SharedMessage {
    SharedVector<std::uint64_t> values;
    SharedString note;
  };
  static void answer(const Request& request, Response& response) {
    response.values.assign(request.count, request.value);
    response.note.assign(request.note.begin(), request.note.end());
  }
};

/// The same request, another response.
struct Count {
  using Request = Repeat::Request;
  struct Response : SharedMessage {
    std::uint64_t count = 0;
  };
};

}  // namespace agnocast::test

template <>
struct agnocast::MessageTraits<agnocast::test::Repeat::Request> {
  static constexpr const char* name = "tests/srv/Repeat_Request";
  static void for_each_pointer(const test::Repeat::Request& request,
                               PointerVisitor& visit) noexcept {
    visit("note", request.note);
  }
};
template <>
struct agnocast::MessageTraits<agnocast::test::Repeat::Response> {
  static constexpr const char* name = "tests/srv/Repeat_Response";
  static void for_each_pointer(const test::Repeat::Response& response,
                               PointerVisitor& visit) noexcept {
    visit("values", response.values);
    visit("note", response.note);
  }
};
template <>
struct agnocast::MessageTraits<agnocast::test::Count::Response> {
  static constexpr const char* name = "tests/srv/Count_Response";
};
