// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/message_filters/synchronizer.hpp>

#include <message_filters/sync_policies/approximate_time.h>

namespace agnocast::message_filters::sync_policies {

/// Upstream's policy of this name, for messages of this library.
template <class M0, class M1, class M2 = NullType, class M3 = NullType, class M4 = NullType,
          class M5 = NullType, class M6 = NullType, class M7 = NullType, class M8 = NullType>
struct ApproximateTime
    : ::message_filters::sync_policies::ApproximateTime<M0, M1, M2, M3, M4, M5, M6, M7, M8> {
  using Upstream =
      ::message_filters::sync_policies::ApproximateTime<M0, M1, M2, M3, M4, M5, M6, M7, M8>;
  using Upstream::Upstream;
};

}  // namespace agnocast::message_filters::sync_policies
