#include "link/messages.h"

#include <pb_encode.h>

#include <algorithm>

#include "link/contact_parts.h"
#include "link/proto_text.h"
#include "solve/support_solver.h"

namespace ruffini {
namespace {

constexpr size_t kMessageOverhead = 4'048;  // upper bound of a message without its dense data
static_assert(ruffini_Contacts_size <= kMessageOverhead);
constexpr size_t kPictureOverhead = 1'024;  // of an image's message

bool write_span(pb_ostream_t* stream, const pb_field_t* field, void* const* arg) {
  const auto& bytes = *static_cast<const std::span<const uint8_t>*>(*arg);
  return pb_encode_tag_for_field(stream, field) && pb_encode_string(stream, bytes.data(), bytes.size());
}

// Every step-th pixel of every step-th row.
struct ThinnedPicture {
  const FrameView* frame = nullptr;
  int step = 1;
  std::span<uint8_t> row;  // room for one row of the result

  [[nodiscard]] int width() const { return frame->width / step; }
  [[nodiscard]] int height() const { return frame->height / step; }
};

// Written from where the picture lies, row by row: a copy of it would be as large as all else that is encoded.
bool write_picture(pb_ostream_t* stream, const pb_field_t* field, void* const* arg) {
  const auto& picture = *static_cast<const ThinnedPicture*>(*arg);
  const size_t n_row = static_cast<size_t>(picture.width()) * 3;
  if (!pb_encode_tag_for_field(stream, field)) return false;
  if (!pb_encode_varint(stream, n_row * static_cast<size_t>(picture.height()))) return false;
  for (int y = 0; y < picture.height(); ++y) {
    const uint8_t* pixels = picture.frame->row(y * picture.step);
    if (picture.step > 1) {
      auto out = picture.row.begin();
      for (int x = 0; x < picture.width(); ++x) out = std::copy_n(pixels + ptrdiff_t{3} * x * picture.step, 3, out);
      pixels = picture.row.data();
    }
    if (!pb_write(stream, pixels, n_row)) return false;
  }
  return true;
}

ruffini_Stamp to_proto(const FrameStamp& stamp, uint32_t flags) {
  return {.capture_us = stamp.capture_us, .frame = stamp.frame, .flags = flags, .calibration_id = stamp.calibration_id};
}

// Stick and slip are derived from shear and pressure: they are not measured unless both are in newtons.
bool is_force(const FrameState& s) { return s.force.xy == Validity::kValid && s.force.z == Validity::kValid; }

}  // namespace

size_t write_frames(ruffini_MessageType type, uint8_t flags, uint8_t sensor, uint32_t sequence,
                    std::span<const uint8_t> message, std::vector<uint8_t>& out) {
  const size_t n_fragments = std::max<size_t>((message.size() + kMaxPayloadBytes - 1) / kMaxPayloadBytes, 1);
  if (n_fragments > kMaxFragments) return 0;
  size_t at = 0;
  for (size_t i = 0; i < n_fragments; ++i) {
    const size_t begin = i * kMaxPayloadBytes;
    const FrameHeader header{flags,    static_cast<uint8_t>(type), sensor,
                             sequence, static_cast<uint8_t>(i),    static_cast<uint8_t>(n_fragments)};
    at += encode_frame(header, message.subspan(begin, std::min(kMaxPayloadBytes, message.size() - begin)),
                       std::span<uint8_t, kMaxFrameBytes>(out.data() + at, kMaxFrameBytes));
  }
  return at;
}

MessageEncoder::MessageEncoder(const FramePath& path, uint8_t sensor) : sensor_(sensor) {
  const auto n_nodes = static_cast<size_t>(path.nodes().size().count());
  const auto n_depth = static_cast<size_t>(path.state().depth.grid.count());
  const size_t n_values = std::max(
      {3 * n_nodes, n_depth, 2 * path.markers().size(), 2 * path.targets().size(), path.state().features.value.size()});
  const auto n_row = static_cast<size_t>(path.board().camera.width_px) * 3;
  values_.resize(n_values);
  row_.resize(n_row);
  dense_[0].resize(dense_bound(n_values));
  dense_[1].resize(dense_bound(3 * n_nodes));
  dense_[2].resize(dense_bound(n_nodes));
  dense_[3].resize(dense_bound(3 * n_nodes));
  size_t n_dense = 0;
  for (const std::vector<uint8_t>& part : dense_) n_dense += part.size();
  const size_t n_picture = n_row * static_cast<size_t>(path.board().camera.height_px);
  const size_t n_message = std::min(kMessageOverhead + std::max(n_dense, n_picture), kMaxFragments * kMaxPayloadBytes);
  frames_.resize(frames_bound(n_message));
}

// Writes each frame as soon as its part is full, so that the whole message, which may be a picture, is never stored.
size_t MessageEncoder::serialise(const pb_msgdesc_t* fields, const void* message) {
  header_.sequence = sequence_++;  // also of a message that cannot be sent, so that the host counts the gap
  size_t n_message = 0;
  if (!pb_get_encoded_size(&n_message, fields, message) || n_message == 0) return 0;
  const size_t n_fragments = (n_message + kMaxPayloadBytes - 1) / kMaxPayloadBytes;
  if (n_fragments > kMaxFragments || frames_bound(n_message) > frames_.size()) return 0;
  header_.n_fragments = static_cast<uint8_t>(n_fragments);
  n_part_ = n_frames_ = 0;
  pb_ostream_t stream = PB_OSTREAM_SIZING;
  stream.callback = [](pb_ostream_t* s, const pb_byte_t* bytes, size_t n) {
    static_cast<MessageEncoder*>(s->state)->take({bytes, n});
    return true;
  };
  stream.state = this;
  stream.max_size = n_message;
  if (!pb_encode(&stream, fields, message)) return 0;
  if (n_part_ > 0) write_part();
  return n_frames_;
}

void MessageEncoder::take(std::span<const uint8_t> bytes) {
  while (!bytes.empty()) {
    const size_t n = std::min(bytes.size(), part_.size() - n_part_);
    std::copy_n(bytes.begin(), n, part_.begin() + static_cast<ptrdiff_t>(n_part_));
    n_part_ += n;
    bytes = bytes.subspan(n);
    if (n_part_ == part_.size()) write_part();
  }
}

void MessageEncoder::write_part() {
  n_frames_ += encode_frame(header_, {part_.data(), n_part_},
                            std::span<uint8_t, kMaxFrameBytes>(frames_.data() + n_frames_, kMaxFrameBytes));
  ++header_.fragment;
  n_part_ = 0;
}

// Packs values_ (size.count() x n_components) and sets `out` to the bytes.
void MessageEncoder::pack(ruffini_Dense& out, GridSize size, size_t n_components, size_t part) {
  const size_t n_values = static_cast<size_t>(size.count()) * n_components;
  const DenseBytes packed = encode_dense({values_.data(), n_values}, n_components, dense_[part]);
  span_[part] = {dense_[part].data(), packed.n_bytes};
  out.codec = packed.codec == DenseCodec::kSparse ? ruffini_Dense_Codec_CODEC_SPARSE : ruffini_Dense_Codec_CODEC_PACKED;
  out.n_x = static_cast<uint32_t>(size.n_x);
  out.n_y = static_cast<uint32_t>(size.n_y);
  out.n_components = static_cast<uint32_t>(n_components);
  out.data.funcs.encode = write_span;
  out.data.arg = &span_[part];
}

size_t MessageEncoder::wrench(const FramePath& path, const FrameStamp& stamp) {
  const FrameState& s = path.state();
  ruffini_Wrench m = ruffini_Wrench_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, s.flags);
  m.validity_count = 6;
  std::transform(s.wrench.validity.begin(), s.wrench.validity.end(), m.validity,
                 [](Validity v) { return to_proto(v); });
  m.force_x_un = s.wrench.sum.force_x_un;
  m.force_y_un = s.wrench.sum.force_y_un;
  m.force_z_un = s.wrench.sum.force_z_un;
  m.torque_x_un_um = s.wrench.sum.torque_x_un_um;
  m.torque_y_un_um = s.wrench.sum.torque_y_un_um;
  m.torque_z_un_um = s.wrench.sum.torque_z_un_um;
  m.covariance_validity = to_proto(s.covariance.validity);
  if (s.covariance.is_stated) {
    m.covariance_count = WrenchCovariance::kSize;
    std::copy(s.covariance.wrench.upper.begin(), s.covariance.wrench.upper.end(), m.covariance);
  }
  return serialise(ruffini_Wrench_fields, &m);
}

size_t MessageEncoder::field(const FramePath& path, const FrameStamp& stamp) {
  const FrameState& s = path.state();
  ruffini_Field m = ruffini_Field_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, s.flags);
  m.force_lsb_un = static_cast<uint32_t>(path.board().force_lsb_un);
  m.displacement_lsb_nm = kDisplacementLsbNm;
  m.validity_count = 3;
  m.validity[0] = m.validity[1] = to_proto(s.force.xy);
  m.validity[2] = to_proto(s.force.z);
  for (size_t i = 0; i < s.solve.force.size(); ++i) {
    values_[3 * i] = s.solve.force[i].x;
    values_[3 * i + 1] = s.solve.force[i].y;
    values_[3 * i + 2] = s.solve.force[i].z;
  }
  m.has_force = true;
  pack(m.force, path.nodes().size(), 3, 0);
  for (size_t i = 0; i < s.displacement.node.size(); ++i) {
    values_[3 * i] = s.displacement.node[i].x.raw();
    values_[3 * i + 1] = s.displacement.node[i].y.raw();
    values_[3 * i + 2] = s.displacement.node[i].z.raw();
  }
  m.has_displacement = true;
  pack(m.displacement, path.nodes().size(), 3, 1);
  if (is_force(s) && !s.slip.node.empty()) {
    std::transform(s.slip.node.begin(), s.slip.node.end(), values_.begin(),
                   [](NodeSlip slip) { return static_cast<int32_t>(slip); });
    m.has_slip = true;
    pack(m.slip, path.nodes().size(), 1, 2);
  }
  m.sigma_validity = to_proto(s.uncertainty.validity);
  if (s.uncertainty.is_stated) {
    for (size_t i = 0; i < s.uncertainty.node.size(); ++i) {
      values_[3 * i] = s.uncertainty.node[i].x;
      values_[3 * i + 1] = s.uncertainty.node[i].y;
      values_[3 * i + 2] = s.uncertainty.node[i].z;
    }
    m.has_sigma = true;
    pack(m.sigma, path.nodes().size(), 3, 3);
  }
  return serialise(ruffini_Field_fields, &m);
}

size_t MessageEncoder::residual(const FramePath& path, const FrameStamp& stamp) {
  const auto& residual = path.state().residual;
  ruffini_Residual m = ruffini_Residual_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, path.state().flags);
  m.validity = to_proto(residual.validity);
  if (residual.validity != Validity::kNotMeasured) {
    m.residual_lsb_1e6 = 1'000'000 >> SupportSolver::kResidualFraction;
    std::copy(residual.node.begin(), residual.node.end(), values_.begin());
    m.has_residual = true;
    pack(m.residual, path.nodes().size(), 3, 0);
  }
  return serialise(ruffini_Residual_fields, &m);
}

size_t MessageEncoder::depth(const FramePath& path, const FrameStamp& stamp) {
  const FrameState& s = path.state();
  ruffini_Depth m = ruffini_Depth_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, s.flags);
  m.depth_lsb_nm = kDisplacementLsbNm;
  m.step_px = static_cast<uint32_t>(s.depth.step_px);
  m.validity = to_proto(s.depth.validity);
  m.sigma_um = static_cast<uint32_t>(s.depth.sigma_um);
  std::transform(s.depth.cell.begin(), s.depth.cell.end(), values_.begin(),
                 [](DisplacementUm d) { return int32_t{d.raw()}; });
  m.has_depth = true;
  pack(m.depth, s.depth.grid, 1, 0);
  return serialise(ruffini_Depth_fields, &m);
}

size_t MessageEncoder::contacts(const FramePath& path, const FrameStamp& stamp) {
  const FrameState& s = path.state();
  ruffini_Contacts m = ruffini_Contacts_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, s.flags);
  m.n_found = static_cast<uint32_t>(s.contacts.n_found);
  m.contacts_count = static_cast<pb_size_t>(s.contacts.n_listed);
  for (size_t i = 0; i < m.contacts_count; ++i) {
    const Contact& c = s.contacts.contacts[i];
    ruffini_Contact& out = m.contacts[i];
    out.id = static_cast<uint32_t>(i);
    out.area_um2_k = static_cast<uint32_t>(c.area_um2 / 1'000);
    out.center_x_um = static_cast<int32_t>(c.center_x_um);
    out.center_y_um = static_cast<int32_t>(c.center_y_um);
    out.force_x_un = c.force_x_un;
    out.force_y_un = c.force_y_un;
    out.force_z_un = c.force_z_un;
    out.peak_depth_nm = static_cast<int32_t>(c.peak_depth_nm);
    out.validity = to_proto(s.force.z);
    out.reaches_border = c.reaches_border;
  }
  for (const ContactPart& part : contact_parts()) {
    if (path.writes(part.slot)) part.encode(s, path.board(), m);
  }
  return serialise(ruffini_Contacts_fields, &m);
}

size_t MessageEncoder::targets(const FramePath& path, const FrameStamp& stamp) {
  const std::span<const Target> targets = path.targets();
  ruffini_Markers m = ruffini_Markers_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, path.state().flags);
  const GridSize row{.n_x = static_cast<int>(targets.size()), .n_y = 1};
  m.n_x = static_cast<uint32_t>(row.n_x);
  m.n_y = 1;
  m.position_lsb_upx = 1'000;
  m.lost.size = static_cast<pb_size_t>((targets.size() + 7) / 8);
  for (size_t i = 0; i < targets.size(); ++i) {
    const Target& t = targets[i];
    values_[2 * i] = static_cast<int32_t>(round_shift((t.now.x_q16 - t.rest.x_q16) * 1'000, 16));
    values_[2 * i + 1] = static_cast<int32_t>(round_shift((t.now.y_q16 - t.rest.y_q16) * 1'000, 16));
    if (t.is_lost) m.lost.bytes[i / 8] = static_cast<uint8_t>(m.lost.bytes[i / 8] | 1U << (i % 8));
  }
  m.has_displacement = true;
  pack(m.displacement, row, 2, 0);
  std::transform(targets.begin(), targets.end(), values_.begin(),
                 [](const Target& t) { return static_cast<int32_t>(t.now.area_q8 - t.rest.area_q8); });
  m.has_area = true;
  pack(m.area, row, 1, 1);
  return serialise(ruffini_Markers_fields, &m);
}

size_t MessageEncoder::markers(const FramePath& path, const FrameStamp& stamp) {
  if (path.has_targets()) return targets(path, stamp);
  const std::span<const Marker> markers = path.markers();
  ruffini_Markers m = ruffini_Markers_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, path.state().flags);
  const GridSize lattice = path.board().markers.lattice;
  m.n_x = static_cast<uint32_t>(lattice.n_x);
  m.n_y = static_cast<uint32_t>(lattice.n_y);
  m.position_lsb_upx = 1'000;  // Q16 rounded to thousandths of a pixel
  m.lost.size = static_cast<pb_size_t>((markers.size() + 7) / 8);
  for (size_t i = 0; i < markers.size(); ++i) {
    values_[2 * i] = static_cast<int32_t>(round_shift(int64_t{markers[i].displacement_x.raw()} * 1'000, 16));
    values_[2 * i + 1] = static_cast<int32_t>(round_shift(int64_t{markers[i].displacement_y.raw()} * 1'000, 16));
    if (markers[i].is_lost) m.lost.bytes[i / 8] = static_cast<uint8_t>(m.lost.bytes[i / 8] | 1U << (i % 8));
  }
  m.has_displacement = true;
  pack(m.displacement, lattice, 2, 0);
  if (path.has_marker_quality()) {
    std::transform(markers.begin(), markers.end(), values_.begin(),
                   [](const Marker& marker) { return int32_t{marker.quality}; });
    m.has_quality = true;
    pack(m.quality, lattice, 1, 1);
  }
  return serialise(ruffini_Markers_fields, &m);
}

size_t MessageEncoder::features(const FramePath& path, const FrameStamp& stamp) {
  const std::vector<int32_t>& value = path.state().features.value;
  ruffini_Features m = ruffini_Features_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, path.state().flags);
  std::copy(value.begin(), value.end(), values_.begin());
  m.has_value = true;
  pack(m.value, {.n_x = static_cast<int>(value.size()), .n_y = 1}, 1, 0);
  return serialise(ruffini_Features_fields, &m);
}

size_t MessageEncoder::image(const FrameView& frame, const FramePath& path, const FrameStamp& stamp) {
  ruffini_Image m = ruffini_Image_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto(stamp, path.state().flags);
  m.format = ruffini_Image_Format_FORMAT_BGR8;
  // Decimated until it fits one message.
  ThinnedPicture picture{.frame = &frame, .row = row_};
  const auto n_bytes = [&] { return static_cast<size_t>(picture.width() * picture.height()) * 3; };
  while (n_bytes() + kPictureOverhead > kMaxFragments * kMaxPayloadBytes) ++picture.step;
  m.width_px = static_cast<uint32_t>(picture.width());
  m.height_px = static_cast<uint32_t>(picture.height());
  m.step_px = static_cast<uint32_t>(picture.step);
  m.data.funcs.encode = write_picture;
  m.data.arg = &picture;
  return serialise(ruffini_Image_fields, &m);
}

void MessageEncoder::encode(ruffini_MessageType type, const FramePath& path, const FrameView& frame,
                            const FrameStamp& stamp, const Sink& sink) {
  header_ = {.flags = stamp.flags, .type = static_cast<uint8_t>(type), .sensor = sensor_};
  size_t n = 0;
  switch (type) {
    case ruffini_MessageType_MESSAGE_TYPE_WRENCH:
      n = wrench(path, stamp);
      break;
    case ruffini_MessageType_MESSAGE_TYPE_FIELD:
      n = field(path, stamp);
      break;
    case ruffini_MessageType_MESSAGE_TYPE_DEPTH:
      n = depth(path, stamp);
      break;
    case ruffini_MessageType_MESSAGE_TYPE_CONTACTS:
      n = contacts(path, stamp);
      break;
    case ruffini_MessageType_MESSAGE_TYPE_MARKERS:
      n = markers(path, stamp);
      break;
    case ruffini_MessageType_MESSAGE_TYPE_FEATURES:
      n = features(path, stamp);
      break;
    case ruffini_MessageType_MESSAGE_TYPE_RESIDUAL:
      n = residual(path, stamp);
      break;
    case ruffini_MessageType_MESSAGE_TYPE_IMAGE:
      n = image(frame, path, stamp);
      break;
    default:
      return;
  }
  if (n > 0) sink(type, {frames_.data(), n});
}

void MessageEncoder::encode(const LearnedResult& result, std::span<const std::string> names, uint8_t flags,
                            const Sink& sink) {
  static_assert(pb_arraysize(ruffini_Learned, quantities) == kMaxLearned);
  const LearnedStamp& stamp = result.stamp;
  ruffini_Learned m = ruffini_Learned_init_zero;
  m.has_stamp = true;
  m.stamp = to_proto({stamp.capture_us, stamp.frame, stamp.calibration_id}, stamp.flags);
  m.validity = to_proto(result.is_valid ? Validity::kValid : Validity::kInvalid);
  m.quantities_count = static_cast<pb_size_t>(result.n_values);
  for (size_t i = 0; i < result.n_values; ++i) {
    copy_text(m.quantities[i].name, names[i]);
    m.quantities[i].value = result.value[i];
  }
  m.took_us = result.took_us;
  m.latency_us = result.latency_us;
  m.period_us = result.period_us;
  header_ = {.flags = flags, .type = ruffini_MessageType_MESSAGE_TYPE_LEARNED, .sensor = sensor_};
  const size_t n = serialise(ruffini_Learned_fields, &m);
  if (n > 0) sink(ruffini_MessageType_MESSAGE_TYPE_LEARNED, {frames_.data(), n});
}

}  // namespace ruffini
