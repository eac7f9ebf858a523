// SPDX-License-Identifier: Apache-2.0
//
// Identity, init options and contexts.

#include <ros2/rmw_agnocast_cpp/src/common.hpp>

#include <agnocast/connection_state.hpp>

#include <rcutils/strdup.h>
#include <rmw/domain_id.h>
#include <rmw/features.h>
#include <rmw/init.h>
#include <rmw/init_options.h>

#include <cstring>

using namespace agnocast;
using namespace agnocast::rmw;

namespace agnocast::rmw {
const char* copied_text(const std::string& text) noexcept {
  auto* const copy = static_cast<char*>(rmw_allocate(text.size() + 1));
  if (copy != nullptr) std::memcpy(copy, text.c_str(), text.size() + 1);
  return copy;
}
}  // namespace agnocast::rmw

extern "C" {

const char* rmw_get_implementation_identifier() { return identifier; }
const char* rmw_get_serialization_format() { return "cdr"; }

rmw_ret_t rmw_init_options_init(rmw_init_options_t* init_options, rcutils_allocator_t allocator) {
  AGNOCAST_RMW_NOT_NULL(init_options);
  RCUTILS_CHECK_ALLOCATOR(&allocator, return RMW_RET_INVALID_ARGUMENT);
  if (init_options->implementation_identifier != nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the init options are initialized already");
  init_options->instance_id = 0;
  init_options->implementation_identifier = identifier;
  init_options->allocator = allocator;
  init_options->impl = nullptr;
  init_options->localhost_only = RMW_LOCALHOST_ONLY_DEFAULT;
  init_options->domain_id = RMW_DEFAULT_DOMAIN_ID;
  init_options->enclave = nullptr;
  init_options->security_options = rmw_get_zero_initialized_security_options();
  return RMW_RET_OK;
}

rmw_ret_t rmw_init_options_copy(const rmw_init_options_t* src, rmw_init_options_t* dst) {
  AGNOCAST_RMW_NOT_NULL(src);
  AGNOCAST_RMW_NOT_NULL(dst);
  if (src->implementation_identifier == nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the init options are not initialized");
  AGNOCAST_RMW_OURS(src);
  if (dst->implementation_identifier != nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the target of a copy is initialized already");
  rcutils_allocator_t allocator = src->allocator;
  RCUTILS_CHECK_ALLOCATOR(&allocator, return RMW_RET_INVALID_ARGUMENT);
  rmw_init_options_t copy = *src;
  copy.enclave = rcutils_strdup(src->enclave, allocator);
  if (src->enclave != nullptr && copy.enclave == nullptr) return RMW_RET_BAD_ALLOC;
  copy.security_options = rmw_get_zero_initialized_security_options();
  const rmw_ret_t copied =
      rmw_security_options_copy(&src->security_options, &allocator, &copy.security_options);
  if (copied != RMW_RET_OK) {
    allocator.deallocate(copy.enclave, allocator.state);
    return copied;
  }
  *dst = copy;
  return RMW_RET_OK;
}

rmw_ret_t rmw_init_options_fini(rmw_init_options_t* init_options) {
  AGNOCAST_RMW_NOT_NULL(init_options);
  if (init_options->implementation_identifier == nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the init options are not initialized");
  AGNOCAST_RMW_OURS(init_options);
  rcutils_allocator_t allocator = init_options->allocator;
  RCUTILS_CHECK_ALLOCATOR(&allocator, return RMW_RET_INVALID_ARGUMENT);
  allocator.deallocate(init_options->enclave, allocator.state);
  const rmw_ret_t ended = rmw_security_options_fini(&init_options->security_options, &allocator);
  *init_options = rmw_get_zero_initialized_init_options();
  return ended;
}

rmw_ret_t rmw_init(const rmw_init_options_t* options, rmw_context_t* context) {
  AGNOCAST_RMW_NOT_NULL(options);
  AGNOCAST_RMW_NOT_NULL(context);
  if (options->implementation_identifier == nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the init options are not initialized");
  AGNOCAST_RMW_OURS(options);
  if (options->enclave == nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the init options have no enclave");
  if (context->implementation_identifier != nullptr)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the context is initialized already");
  return guarded([&] {
    const auto domain = options->domain_id == RMW_DEFAULT_DOMAIN_ID
                            ? domain_id()
                            : Result<std::uint64_t>(options->domain_id);
    if (!domain) return refuse(domain.error());
    rmw_context_t made = rmw_get_zero_initialized_context();
    auto impl = std::make_unique<rmw_context_impl_s>();
    // Connects, so that a missing agnocastd is reported here, in one sentence.
    auto wait = impl->pool.take();
    if (!wait) return refuse(wait.error());
    impl->pool.give_back(std::move(*wait));
    made.options = rmw_get_zero_initialized_init_options();
    if (const rmw_ret_t copied = rmw_init_options_copy(options, &made.options);
        copied != RMW_RET_OK)
      return copied;
    made.instance_id = options->instance_id;
    made.implementation_identifier = identifier;
    made.actual_domain_id = *domain;
    impl->domain = *domain;
    made.impl = impl.release();
    *context = made;
    return rmw_ret_t{RMW_RET_OK};
  });
}

rmw_ret_t rmw_shutdown(rmw_context_t* context) {
  AGNOCAST_RMW_NOT_NULL(context);
  RMW_CHECK_FOR_NULL_WITH_MSG(context->impl, "the context is not initialized",
                              return RMW_RET_INVALID_ARGUMENT);
  AGNOCAST_RMW_OURS(context);
  context->impl->is_shut_down = true;
  return RMW_RET_OK;
}

rmw_ret_t rmw_context_fini(rmw_context_t* context) {
  AGNOCAST_RMW_NOT_NULL(context);
  RMW_CHECK_FOR_NULL_WITH_MSG(context->impl, "the context is not initialized",
                              return RMW_RET_INVALID_ARGUMENT);
  AGNOCAST_RMW_OURS(context);
  if (!context->impl->is_shut_down)
    return refuse(RMW_RET_INVALID_ARGUMENT, "the context is not shut down");
  const rmw_ret_t ended = rmw_init_options_fini(&context->options);
  if (!context->impl->is_in_child()) delete context->impl;
  *context = rmw_get_zero_initialized_context();
  return ended;
}

bool rmw_feature_supported(rmw_feature_t) { return false; }
rmw_ret_t rmw_set_log_severity(rmw_log_severity_t) { return RMW_RET_OK; }

}  // extern "C"
