// SPDX-License-Identifier: Apache-2.0
//
// The two tables of functions. Cyclone DDS is C: no exception may pass through it.

#include <bridge/dds/raw_type.hpp>

#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <dds/ddsi/ddsi_sertype.h>
#include <dds/ddsi/q_radmin.h>

#include <algorithm>
#include <cstring>
#include <limits>
#include <new>
#include <utility>
#include <vector>

namespace agnocast::bridge {
namespace {

// A written sample has `bytes`. A received one has `object`, unless it was refused or carries no
// data. It holds no reference to its type, so its destruction does not touch the type.
struct RawSample : ddsi_serdata {
  std::unique_ptr<std::byte[]> bytes;
  std::uint32_t size = 0;
  std::shared_ptr<void> object;
  // For a received sample, which is in a cache until its destruction.
  std::shared_ptr<RawCounts> counts;
  std::uint64_t unread_bytes = 0;

  ~RawSample() {
    if (unread_bytes == 0) return;
    counts->unread_bytes -= unread_bytes;
    counts->shared->unread_bytes -= unread_bytes;
  }
};

struct RawType : ddsi_sertype {
  RawDecoder decoder;
  std::shared_ptr<RawCounts> counts;
  // Without a key there is one instance, without data. Cyclone DDS asks for it with each sample
  // and accepts no refusal.
  std::unique_ptr<ddsi_serdata, decltype(&ddsi_serdata_unref)> untyped{nullptr,
                                                                       &ddsi_serdata_unref};
};

const RawType& type_of(const ddsi_sertype* type) { return *static_cast<const RawType*>(type); }
const RawSample& sample_of(const ddsi_serdata* sample) {
  return *static_cast<const RawSample*>(sample);
}

RawSample* make_sample(const ddsi_sertype* type, ddsi_serdata_kind kind) {
  auto* const sample = new (std::nothrow) RawSample;
  if (sample != nullptr) ddsi_serdata_init(sample, type, kind);
  return sample;
}

/// Reserves room for a payload until the sample is destroyed; returns false, and counts it, if
/// there is none. A reader without unread messages always gets one, so no flood keeps another
/// reader from its messages.
bool take_room(RawSample& sample, const std::shared_ptr<RawCounts>& counts, std::uint64_t bytes) {
  RawShared& shared = *counts->shared;
  const auto beyond = [&](Limit limit) {
    ++counts->overflow;
    shared.limits.refuse(limit);
    return false;
  };
  if (bytes > most_of(Limit::message_bytes)) return beyond(Limit::message_bytes);
  // A message counts as at least a KiB, the cost of keeping it.
  bytes = std::max<std::uint64_t>(bytes, 1024);
  const std::uint64_t before = counts->unread_bytes.fetch_add(bytes);
  const std::uint64_t all_before = shared.unread_bytes.fetch_add(bytes);
  sample.counts = counts;
  sample.unread_bytes = bytes;
  if (before == 0) return true;
  if (before + bytes > counts->unread_bytes_max) return beyond(Limit::unread_bytes_of_reader);
  if (all_before + bytes > most_of(Limit::unread_bytes)) return beyond(Limit::unread_bytes);
  return true;
}

void give_room_back(RawSample& sample) {
  sample.counts->unread_bytes -= sample.unread_bytes;
  sample.counts->shared->unread_bytes -= sample.unread_bytes;
  sample.unread_bytes = 0;
}

// A refused payload becomes a sample without an object, which take() skips. Without a sample,
// Cyclone DDS would log a line for each, at the will of another host.
ddsi_serdata* receive(const ddsi_sertype* type, ddsi_serdata_kind kind, RawPieces pieces,
                      std::size_t size, bool is_whole) noexcept {
  RawSample* const sample = make_sample(type, kind);
  if (sample == nullptr || kind != SDK_DATA) return sample;
  const RawType& of = type_of(type);
  if (!take_room(*sample, of.counts, size)) {
    if (sample->unread_bytes != 0) give_room_back(*sample);
    return sample;
  }
  try {
    if (is_whole && of.decoder) sample->object = of.decoder(pieces);
  } catch (const std::bad_alloc&) {
    give_room_back(*sample);
    return sample;  // the payload itself may be valid
  } catch (...) {
  }
  ++(sample->object ? of.counts->decoded : of.counts->refused);
  if (!sample->object) give_room_back(*sample);
  return sample;
}

// Fragments may overlap; they are ordered by their first bytes.
ddsi_serdata* from_ser(const ddsi_sertype* type, ddsi_serdata_kind kind, const nn_rdata* fragment,
                       std::size_t size) noexcept {
  std::vector<std::span<const std::byte>> pieces;
  std::size_t end = 0;
  try {
    for (; fragment != nullptr && end < size; fragment = fragment->nextfrag) {
      if (fragment->min > end) break;
      if (fragment->maxp1 <= end) continue;
      const auto* const payload = reinterpret_cast<const std::byte*>(
          NN_RMSG_PAYLOADOFF(fragment->rmsg, NN_RDATA_PAYLOAD_OFF(fragment)));
      const std::size_t last = std::min<std::size_t>(fragment->maxp1, size);
      pieces.emplace_back(payload + (end - fragment->min), last - end);
      end = last;
    }
  } catch (const std::bad_alloc&) {
    end = 0;
  }
  return receive(type, kind, pieces, size, end == size);
}

ddsi_serdata* from_ser_iov(const ddsi_sertype* type, ddsi_serdata_kind kind,
                           ddsrt_msg_iovlen_t count, const ddsrt_iovec_t* iov,
                           std::size_t size) noexcept {
  std::vector<std::span<const std::byte>> pieces;
  std::size_t end = 0;
  try {
    for (std::size_t i = 0; i < count && end < size; ++i) {
      const std::size_t length = std::min<std::size_t>(iov[i].iov_len, size - end);
      pieces.emplace_back(static_cast<const std::byte*>(iov[i].iov_base), length);
      end += length;
    }
  } catch (const std::bad_alloc&) {
    end = 0;
  }
  return receive(type, kind, pieces, size, end == size);
}

// Only for written samples: received ones are never sent on.
ddsi_serdata* to_ser_ref(const ddsi_serdata* sample, std::size_t offset, std::size_t size,
                         ddsrt_iovec_t* piece) noexcept {
  piece->iov_base = sample_of(sample).bytes.get() + offset;
  piece->iov_len = size;
  return ddsi_serdata_ref(sample);
}
void to_ser(const ddsi_serdata* sample, std::size_t offset, std::size_t size, void* to) noexcept {
  std::memcpy(to, sample_of(sample).bytes.get() + offset, size);
}

ddsi_serdata* to_untyped(const ddsi_serdata* sample) noexcept {
  return ddsi_serdata_ref(type_of(sample->type).untyped.get());
}

const ddsi_serdata_ops sample_functions = {
    .eqkey = [](const ddsi_serdata*, const ddsi_serdata*) { return true; },
    .get_size = [](const ddsi_serdata* sample) { return sample_of(sample).size; },
    .from_ser = from_ser,
    .from_ser_iov = from_ser_iov,
    .from_keyhash = [](const ddsi_sertype* type, const ddsi_keyhash*) -> ddsi_serdata* {
      return make_sample(type, SDK_KEY);
    },
    .from_sample = [](const ddsi_sertype* type, ddsi_serdata_kind kind, const void*)
        -> ddsi_serdata* { return kind == SDK_KEY ? make_sample(type, kind) : nullptr; },
    .to_ser = to_ser,
    .to_ser_ref = to_ser_ref,
    .to_ser_unref = [](ddsi_serdata* sample, const ddsrt_iovec_t*) { ddsi_serdata_unref(sample); },
    .to_sample = [](const ddsi_serdata*, void*, void**, void*) { return false; },
    .to_untyped = to_untyped,
    .untyped_to_sample = [](const ddsi_sertype*, const ddsi_serdata*, void*, void**,
                            void*) { return false; },
    .free = [](ddsi_serdata* sample) { delete static_cast<RawSample*>(sample); },
    .print = [](const ddsi_sertype*, const ddsi_serdata*, char* text, std::size_t) -> std::size_t {
      text[0] = '\0';
      return 0;
    },
    .get_keyhash = [](const ddsi_serdata*, ddsi_keyhash* hash, bool) { *hash = {}; },
#ifdef DDS_HAS_SHM
    // Without these, and with a type that cannot give its size, iceoryx is not used even if it is
    // configured.
    .get_sample_size = nullptr,
    .from_iox_buffer = nullptr,
#endif
};

const ddsi_sertype_ops type_functions = {
    .version = ddsi_sertype_v0,
    .arg = nullptr,
    .free =
        [](ddsi_sertype* type) {
          ddsi_sertype_fini(type);
          delete static_cast<RawType*>(type);
        },
    .zero_samples = [](const ddsi_sertype*, void*, std::size_t) {},
    .realloc_samples = [](void** samples, const ddsi_sertype*, void*, std::size_t,
                          std::size_t) { *samples = nullptr; },
    .free_samples = [](const ddsi_sertype*, void**, std::size_t, dds_free_op_t) {},
    .equal = [](const ddsi_sertype* left, const ddsi_sertype* right) { return left == right; },
    // Must differ between types: Cyclone's table of types grows without end when many fall into
    // one slot.
    .hash =
        [](const ddsi_sertype* type) {
          return static_cast<std::uint32_t>(std::hash<const void*>()(type) / alignof(RawType));
        },
    .type_id = nullptr,
    .type_map = nullptr,
    .type_info = nullptr,
    .derive_sertype = nullptr,
    .get_serialized_size = nullptr,
    .serialize_into = nullptr,
};

}  // namespace

ddsi_sertype* make_raw_type(const std::string& name, RawDecoder decoder,
                            std::shared_ptr<RawCounts> counts) {
  auto type = std::make_unique<RawType>();
  type->decoder = std::move(decoder);
  type->counts = std::move(counts);
  ddsi_sertype_init_flags(type.get(), name.c_str(), &type_functions, &sample_functions,
                          DDSI_SERTYPE_FLAG_TOPICKIND_NO_KEY);
  type->allowed_data_representation = DDS_DATA_REPRESENTATION_FLAG_XCDR1;
  type->untyped.reset(make_sample(type.get(), SDK_KEY));
  if (type->untyped == nullptr) {
    ddsi_sertype_fini(type.get());
    throw std::bad_alloc();
  }
  type->untyped->type = nullptr;
  return type.release();
}

ddsi_serdata* make_raw_sample(const ddsi_sertype& type, std::size_t size, const RawFill& fill,
                              std::int64_t source_time_ns) noexcept {
  if (size == 0 || size > std::numeric_limits<std::uint32_t>::max() - 3) return nullptr;
  RawSample* const sample = make_sample(&type, SDK_DATA);
  if (sample == nullptr) return nullptr;
  const auto padded = [](std::size_t length) { return (length + 3) / 4 * 4; };
  std::size_t filled = 0;
  try {
    sample->bytes = std::make_unique_for_overwrite<std::byte[]>(padded(size));
    filled = fill({sample->bytes.get(), size});
  } catch (...) {
    filled = 0;
  }
  if (filled == 0 || filled > size) {
    ddsi_serdata_unref(sample);
    return nullptr;
  }
  std::fill_n(sample->bytes.get() + filled, padded(filled) - filled, std::byte{0});
  sample->size = static_cast<std::uint32_t>(padded(filled));
  sample->timestamp.v = source_time_ns;
  return sample;
}

std::shared_ptr<void> object_of(const ddsi_serdata& sample) noexcept {
  return sample_of(&sample).object;
}

}  // namespace agnocast::bridge
