// SPDX-License-Identifier: Apache-2.0
//
// Includes the public interface of libagnocast: nodes, publishers, subscriptions, services,
// errors.
#pragma once

#if defined(AGNOCASTLIB)
// A target that uses the package agnocastlib, whose users write this path as well.
#include <agnocastlib/agnocast.hpp>
#else

#include <agnocast/callback_group.hpp>
#include <agnocast/client.hpp>
#include <agnocast/connection_state.hpp>
#include <agnocast/error.hpp>
#include <agnocast/events.hpp>
#include <agnocast/executor.hpp>
#include <agnocast/heap.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/message_traits.hpp>
#include <agnocast/message_wait.hpp>
#include <agnocast/node.hpp>
#include <agnocast/publisher.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>
#include <agnocast/service.hpp>
#include <agnocast/service_name.hpp>
#include <agnocast/shared_allocator.hpp>
#include <agnocast/subscription.hpp>
#include <agnocast/timer.hpp>
#include <agnocast/version.hpp>

#if __has_include(<rosidl_typesupport_introspection_cpp/message_introspection.hpp>)
#include <agnocast/rosidl.hpp>
#endif

#endif
