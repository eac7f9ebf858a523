// SPDX-License-Identifier: Apache-2.0

#include <daemon/admission/check_caller.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <daemon/transport/request_reading.hpp>

namespace agnocast::daemon {

Result<void> check_caller(const PeerIdentity& who, std::uint64_t fingerprint) {
  if (fingerprint != abi::fingerprint())
    return fail_with(Errc::layout_mismatch, "the library has layout " + hexadecimal(fingerprint) +
                                                ", the daemon has layout " +
                                                hexadecimal(abi::fingerprint()));
  if (!who.confirmed)
    return fail_with(Errc::permission_denied,
                     "the process that connected is not the one that says hello");
  return {};
}

}  // namespace agnocast::daemon
