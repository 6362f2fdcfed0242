#include "capi/slot_views.h"

#include <algorithm>
#include <iterator>

#include "stages/skin/skin_shape.h"

namespace ruffini {
namespace {

ArrayShape shape_of(size_t n) { return {1, {n, 1, 1}}; }
ArrayShape shape_of(size_t n, size_t m) { return {2, {n, m, 1}}; }
ArrayShape shape_of(size_t n, size_t m, size_t k) { return {3, {n, m, k}}; }
ArrayShape grid(GridSize size) { return shape_of(static_cast<size_t>(size.n_y), static_cast<size_t>(size.n_x)); }
ArrayShape grid(GridSize size, size_t n) {
  return shape_of(static_cast<size_t>(size.n_y), static_cast<size_t>(size.n_x), n);
}
template <size_t n>
ArrayShape row(const FramePath& /*path*/) {
  return shape_of(n);
}
template <size_t n, size_t m>
ArrayShape table(const FramePath& /*path*/) {
  return shape_of(n, m);
}
ArrayShape image(const FramePath& path) {
  const CameraSettings& c = path.board().camera;
  return shape_of(static_cast<size_t>(c.height_px), static_cast<size_t>(c.width_px));
}
ArrayShape nodes(const FramePath& path) { return grid(path.nodes().size()); }
ArrayShape vectors(const FramePath& path) { return grid(path.nodes().size(), 3); }
ArrayShape markers(const FramePath& path) { return grid(path.board().markers.lattice); }

template <typename T>
class Out {
 public:
  explicit Out(void* at) : at_(static_cast<T*>(at)) {}
  template <typename... Values>
  void put(Values... values) {
    ((*at_++ = static_cast<T>(values)), ...);
  }
  template <typename Range>
  void put_all(const Range& range) {
    for (const auto& value : range) put(value);
  }
  template <typename Range>
  void put_raw(const Range& range) {
    for (const auto& value : range) put(value.raw());
  }
  template <typename Range>
  void put_xyz(const Range& range) {
    for (const auto& v : range) put(v.x, v.y, v.z);
  }

 private:
  T* at_;
};

const char* no_covariance(FramePath& path) {
  return path.state().covariance.is_stated ? "" : "the last frame states no covariance";
}
const char* no_sigma(FramePath& path) {
  return path.state().uncertainty.is_stated ? "" : "the last frame states no uncertainty";
}
// Computed when it is asked for.
const char* no_residual(FramePath& path) {
  path.compute_residual();
  return path.state().residual.validity == Validity::kNotMeasured ? "the last frame had no second pass" : "";
}

// Each copy is of the shape that stands before it.
constexpr SlotView kViews[] = {
    {"change", Slot::kDifference, "i2", "1/4096 of rest", "b g r",
     [](const FramePath& path) {
       const ArrayShape plane = image(path);
       return shape_of(plane.size[0], plane.size[1], 3);
     },
     [](FramePath& path, void* to) {
       const auto& planes = path.state().difference.change;
       const size_t n = planes.size() / 3;
       Out<int16_t> out(to);
       for (size_t i = 0; i < planes.size(); ++i) out.put(planes[i % 3 * n + i / 3].raw());
       return static_cast<size_t>(path.board().camera.height_px);
     }},
    {"markers", Slot::kMarkers, "i4", "1/65536 px", "rest_x rest_y displacement_x displacement_y",
     [](const FramePath& path) { return grid(path.board().markers.lattice, 4); },
     [](FramePath& path, void* to) {
       Out<int32_t> out(to);
       for (const Marker& m : path.markers()) {
         out.put(m.rest_x.raw(), m.rest_y.raw(), m.displacement_x.raw(), m.displacement_y.raw());
       }
       return markers(path).size[0];
     }},
    {"marker_state", Slot::kMarkers, "u1", "0 seen, 1 lost, 2 absent", "", markers,
     [](FramePath& path, void* to) {
       Out<uint8_t> out(to);
       for (const Marker& m : path.markers()) out.put(m.is_absent ? 2 : m.is_lost ? 1 : 0);
       return markers(path).size[0];
     }},
    {"marker_quality", Slot::kMarkers, "u1", "255 / (1 + (expected error / 0.1 px)^2), 0 lost", "", markers,
     [](FramePath& path, void* to) {
       Out<uint8_t> out(to);
       for (const Marker& m : path.markers()) out.put(m.quality);
       return markers(path).size[0];
     }},
    {"targets", Slot::kTargets, "i8", "1/65536 px, areas 1/256 px^2, light 1/256 grey level",
     "rest_x rest_y rest_area rest_light x y area light is_lost",
     [](const FramePath& path) { return shape_of(path.targets().size(), 9); },
     [](FramePath& path, void* to) {
       Out<int64_t> out(to);
       for (const Target& t : path.targets()) {
         for (const DiscMeasurement& s : {t.rest, t.now}) out.put(s.x_q16, s.y_q16, s.area_q8, s.bright_q8);
         out.put(t.is_lost);
       }
       return path.targets().size();
     }},
    {"features", Slot::kFeatures, "i4", "", "",
     [](const FramePath& path) { return shape_of(path.state().features.value.size()); },
     [](FramePath& path, void* to) {
       Out<int32_t>(to).put_all(path.state().features.value);
       return path.state().features.value.size();
     },
     [](FramePath&) { return ""; }, [](const FramePath& path) { return path.state().features.sort.unit; }},
    {"slope", Slot::kSlope, "i2", "1/4096", "dz_dx dz_dy",
     [](const FramePath& path) { return grid(path.state().depth.grid, 2); },
     [](FramePath& path, void* to) {
       Out<int16_t> out(to);
       for (const CellSlope& s : path.state().photometric.slope) out.put(s.x.raw(), s.y.raw());
       return static_cast<size_t>(path.state().depth.grid.n_y);
     }},
    {"depth", Slot::kDepth, "i2", "125 nm", "", [](const FramePath& path) { return grid(path.state().depth.grid); },
     [](FramePath& path, void* to) {
       Out<int16_t>(to).put_raw(path.state().depth.cell);
       return static_cast<size_t>(path.state().depth.grid.n_y);
     }},
    {"displacement", Slot::kDisplacement, "i2", "125 nm", "x y z", vectors,
     [](FramePath& path, void* to) {
       Out<int16_t> out(to);
       for (const NodeDisplacement& u : path.state().displacement.node) out.put(u.x.raw(), u.y.raw(), u.z.raw());
       return nodes(path).size[0];
     }},
    {"force", Slot::kNodeForces, "i4", "[field] force_lsb_un of the board", "x y z", vectors,
     [](FramePath& path, void* to) {
       Out<int32_t>(to).put_xyz(path.state().solve.force);
       return nodes(path).size[0];
     }},
    {"mask", Slot::kNodeForces, "u1", "0 not touched, 128 surely", "", nodes,
     [](FramePath& path, void* to) {
       Out<uint8_t>(to).put_all(path.state().solve.mask);
       return nodes(path).size[0];
     }},
    {"force_validity", Slot::kForceValidity, "u1", "Validity", "xy z", row<2>,
     [](FramePath& path, void* to) {
       Out<uint8_t>(to).put(path.state().force.xy, path.state().force.z);
       return size_t{2};
     }},
    {"sigma", Slot::kNodeSigma, "i4", "[field] force_lsb_un of the board", "x y z", vectors,
     [](FramePath& path, void* to) {
       Out<int32_t>(to).put_xyz(path.state().uncertainty.node);
       return nodes(path).size[0];
     },
     no_sigma},
    {"residual", Slot::kResidual, "i4", "1/64 standard deviation", "x y z", vectors,
     [](FramePath& path, void* to) {
       Out<int32_t>(to).put_all(path.state().residual.node);
       return nodes(path).size[0];
     },
     no_residual},
    {"wrench", Slot::kWrench, "i8", "uN, uN um", "force_x force_y force_z torque_x torque_y torque_z", row<6>,
     [](FramePath& path, void* to) {
       const Wrench& w = path.state().wrench.sum;
       Out<int64_t>(to).put(w.force_x_un, w.force_y_un, w.force_z_un, w.torque_x_un_um, w.torque_y_un_um,
                            w.torque_z_un_um);
       return size_t{6};
     }},
    {"wrench_validity", Slot::kWrench, "u1", "Validity", "force_x force_y force_z torque_x torque_y torque_z", row<6>,
     [](FramePath& path, void* to) {
       Out<uint8_t>(to).put_all(path.state().wrench.validity);
       return size_t{6};
     }},
    {"covariance", Slot::kCovariance, "i8", "(uN, uN mm)^2, upper triangle by rows", "", row<WrenchCovariance::kSize>,
     [](FramePath& path, void* to) {
       Out<int64_t>(to).put_all(path.state().covariance.wrench.upper);
       return WrenchCovariance::kSize;
     },
     no_covariance},
    {"contacts", Slot::kContacts, "i8", "by column; largest first",
     "n_nodes area_um2 center_x_um center_y_um force_x_un force_y_un force_z_un peak_depth_nm slip_state "
     "shear_ratio_1e3 friction_1e3 friction_sigma_1e3 slip_share_1e3 slip_margin_un reaches_border",
     table<ContactList::kMax, 15>,
     [](FramePath& path, void* to) {
       const FrameState& s = path.state();
       const auto n = static_cast<size_t>(s.contacts.n_listed);
       Out<int64_t> out(to);
       for (size_t i = 0; i < n; ++i) {
         const Contact& c = s.contacts.contacts[i];
         const ContactSlip& slip = s.slip.contact[i];
         out.put(c.n_nodes, c.area_um2, c.center_x_um, c.center_y_um, c.force_x_un, c.force_y_un, c.force_z_un,
                 c.peak_depth_nm, slip.state, slip.ratio_1e3, slip.friction_1e3, slip.friction_sigma_1e3,
                 slip.share_1e3, slip.margin_un, c.reaches_border);
       }
       return n;
     }},
    {"slip", Slot::kSlip, "u1", "0 free, 1 sticks, 2 slips", "", nodes,
     [](FramePath& path, void* to) {
       Out<uint8_t>(to).put_all(path.state().slip.node);
       return nodes(path).size[0];
     }},
    {"touches", Slot::kSkin, "i8", "by column; hardest first",
     "id x_um y_um area_um2 brightness press_un press_sigma_un place_sigma_um force_x_un force_y_un force_z_un",
     table<SkinTouchList::kMax, 11>,
     [](FramePath& path, void* to) {
       const SkinTouchList& list = path.state().skin.touches;
       Out<int64_t> out(to);
       for (size_t i = 0; i < static_cast<size_t>(list.n_listed); ++i) {
         const SkinTouch& t = list.touch[i];
         const auto force = pressing_vector_un(on_skin(path.board().skin, t.x_um, t.y_um), t.press_un);
         out.put(t.id, t.x_um, t.y_um, t.area_um2, t.brightness_q2, t.press_un, t.press_sigma_un, t.place_sigma_um,
                 force[0], force[1], force[2]);
       }
       return static_cast<size_t>(list.n_listed);
     }},
    {"skin", Slot::kSkin, "i8", "1/4096", "light_over_rest age_of_light", row<2>,
     [](FramePath& path, void* to) {
       Out<int64_t>(to).put(path.state().skin.light_q12, path.state().skin.age_q12);
       return size_t{2};
     }},
    {"taxels", Slot::kSkin, "i4", "1/4096 of rest", "",
     [](const FramePath& path) { return shape_of(path.state().skin.ratio.size()); },
     [](FramePath& path, void* to) {
       Out<int32_t>(to).put_all(path.state().skin.ratio);
       return path.state().skin.ratio.size();
     }},
    {"glow", Slot::kSkin, "i2", "1/4 level of the weighted channels over rest; smoothed without taxels", "", image,
     [](FramePath& path, void* to) {
       Out<int16_t>(to).put_all(path.state().skin.glow);
       return image(path).size[0];
     }},
    {"tip", Slot::kToolTouch, "i8", "by column",
     "is_touched is_known is_in_range force_un way_um x_um y_um roll_urad pitch_urad area_um2 sigma_force_un "
     "sigma_way_um sigma_x_um sigma_y_um sigma_roll_urad sigma_pitch_urad sigma_area_um2 flat_um2 sigma_flat_um2",
     row<19>,
     [](FramePath& path, void* to) {
       const TipTouch& t = path.state().tip;
       Out<int64_t> out(to);
       out.put(t.is_touched, t.is_known, t.is_in_range, t.force_un, t.travel_um, t.x_um, t.y_um, t.roll_urad,
               t.pitch_urad, t.area_um2);
       out.put_all(t.sigma);
       out.put(t.flat_area_um2, t.flat_area_sigma_um2);
       return size_t{19};
     }},
    {"radial_flow", Slot::kProfile, "i8", "1/16 um, on 16 rings", "", row<Profile::kRings>,
     [](FramePath& path, void* to) {
       Out<int64_t>(to).put_all(path.state().profile.radial_q4);
       return Profile::kRings;
     }},
    {"profile", Slot::kProfile, "i8", "by column", "size_q4 fall_q16 center_x_um center_y_um lost_1e3 flow_q4", row<6>,
     [](FramePath& path, void* to) {
       const Profile& p = path.state().profile;
       Out<int64_t>(to).put(p.size_q4, p.fall_q16, p.center_x_um, p.center_y_um, p.lost_1e3, p.flow_q4);
       return size_t{6};
     }},
    {"helmholtz", Slot::kHelmholtz, "i8", "by column", "curl_free_q4 divergence_free_q4 twist_urad", row<3>,
     [](FramePath& path, void* to) {
       const HelmholtzSums& s = path.state().helmholtz;
       Out<int64_t>(to).put(s.curl_free_q4, s.divergence_free_q4, s.twist_urad);
       return size_t{3};
     }},
    {"curl_free_flow", Slot::kHelmholtz, "i8", "1/16 um", "x y",
     [](const FramePath& path) { return grid(path.board().markers.lattice, 2); },
     [](FramePath& path, void* to) {
       Out<int64_t> out(to);
       for (const FlowPoint& g : path.state().helmholtz.curl_free) out.put(g.x_q4, g.y_q4);
       return markers(path).size[0];
     }},
    {"contact_model", Slot::kContactModel, "i8", "by column",
     "is_touched kind sure_1e3 gel_depth_um press_depth_um depth_sigma_um area_um2 effective_area_um2 stiffness_pa_um "
     "shore_q4 shore_sigma_q4 is_strange depth_validity hardness_validity mean_flow_um moment_by_flow_unmm",
     row<16>,
     [](FramePath& path, void* to) {
       const ModelledContact& c = path.state().modelled;
       Out<int64_t>(to).put(c.is_touched, c.kind, c.confidence_1e3, c.gel_depth_um, c.press_depth_um, c.depth_sigma_um,
                            c.area_um2, c.effective_area_um2, c.stiffness_pa_um, c.shore_q4, c.shore_sigma_q4,
                            c.is_strange, c.depth_validity, c.hardness_validity, c.mean_flow_um, c.moment_by_flow_unmm);
       return size_t{16};
     }},
    {"vibration", Slot::kVibration, "i4", "by column", "level_cdb validity", row<2>,
     [](FramePath& path, void* to) {
       Out<int32_t>(to).put(path.state().vibration.level_cdb, path.state().vibration.validity);
       return size_t{2};
     }},
    {"softness", Slot::kSoftness, "i8", "by column",
     "n_squeezes n_frames log_share_q16 log_sigma_q16 modulus_pa low_pa high_pa validity", row<8>,
     [](FramePath& path, void* to) {
       const auto& [s, validity] = path.state().softness;
       Out<int64_t>(to).put(s.n_squeezes, s.n_frames, s.log_share_q16, s.log_sigma_q16, s.modulus_pa, s.low_pa,
                            s.high_pa, validity);
       return size_t{8};
     }},
};

}  // namespace

std::span<const SlotView> slot_views() { return kViews; }

}  // namespace ruffini
