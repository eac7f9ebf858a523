// SPDX-License-Identifier: Apache-2.0
//
// The library below. Of the names that this package gives another meaning, its own are in
// agnocast::core (<agnocast/core_namespace.hpp>). Everything here includes this before anything of
// agnocast.
#pragma once

#if defined(AGNOCAST_CORE_IS_INLINE)
#error \
    "agnocast: this file has included a header of the package agnocast before one of agnocastlib. \
Both give names like agnocast::Publisher a meaning: include <agnocast/agnocast.hpp> first, or use \
one of the packages alone"
#endif
#define AGNOCAST_CORE_IS_HIDDEN

#include <agnocast/client.hpp>
#include <agnocast/error.hpp>
#include <agnocast/heap.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/message_traits.hpp>
#include <agnocast/publisher.hpp>
#include <agnocast/rosidl.hpp>
#include <agnocast/service.hpp>
#include <agnocast/subscription.hpp>
#include <agnocast_rclcpp/node_adapter.hpp>
