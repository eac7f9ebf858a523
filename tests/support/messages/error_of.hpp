// SPDX-License-Identifier: Apache-2.0
//
// error_of: returns the text of the error that a call throws.
#pragma once

#include <agnocast/error.hpp>

#include <string>

namespace agnocast::test {

template <class Function>
std::string error_of(Function function) {
  try {
    function();
  } catch (const Error& error) {
    return error.what();
  }
  return "(no error)";
}

}  // namespace agnocast::test
