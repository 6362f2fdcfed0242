/* C interface of the core: the device's own arithmetic for offline use (ctypes).
 *
 * Every function returns 0 on success; otherwise the text of ruffini_error() says what, where and
 * what to do. A handle belongs to one thread at a time. Arrays are C order, sizes as documented by
 * ruffini_layout. */
#ifndef RUFFINI_CORE_H
#define RUFFINI_CORE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define RUFFINI_API __attribute__((visibility("default")))

typedef struct ruffini_pipeline ruffini_pipeline;

typedef struct {
  int32_t width_px, height_px;
  int32_t depth_n_x, depth_n_y, depth_step_px;
  int32_t node_n_x, node_n_y;         /* observed nodes */
  int32_t node_first_x, node_first_y; /* within the pad's grid */
  int32_t marker_n_x, marker_n_y;
  int32_t force_lsb_un;
  int32_t n_targets;
} ruffini_layout_t;

typedef struct {
  uint32_t flags;                   /* FlagBit of ruffini.proto */
  int32_t force_xy, force_z, depth; /* Validity of ruffini.proto */
  int32_t wrench_validity[6];
  int32_t n_markers_lost, n_markers_at_rest;
  uint64_t saturations; /* since ruffini_open */
  int64_t wrench[6];    /* uN, uN um */
  int32_t n_contacts;
  uint64_t stage_ns[16];
} ruffini_result_t;

RUFFINI_API const char* ruffini_version(void);
/* Of the last failed call on this thread. */
RUFFINI_API const char* ruffini_error(void);
/* A board.toml as JSON: keys sorted, decimal integers, defaults of absent keys filled in. NULL with ruffini_error() if
 * the parser refuses the file, which `where` names. The text is valid until the next call on this thread. */
RUFFINI_API const char* ruffini_board_json(const char* toml, size_t toml_bytes, const char* where);

/* `calibration` may be NULL. The signature is not checked here: files from this machine are the caller's. */
RUFFINI_API ruffini_pipeline* ruffini_open(const char* toml, size_t toml_bytes, const char* where,
                                           const uint8_t* calibration, size_t calibration_bytes);
RUFFINI_API void ruffini_close(ruffini_pipeline* pipeline);
RUFFINI_API int ruffini_layout(const ruffini_pipeline* pipeline, ruffini_layout_t* out);

/* B, G, R, width x height of the board. capture_us: time of capture, for the pad's relaxation; 0 leaves that out. */
RUFFINI_API int ruffini_process(ruffini_pipeline* pipeline, const uint8_t* bgr, int32_t width_px, int32_t height_px,
                                uint64_t capture_us, ruffini_result_t* out);
/* Of a calibration with kind `views`: places [n][4] px Q16 of the frame, x and y in the first view, x and y in the
 * second, to [n][4] um Q8: x, y, z, and the gap between the two rays; INT32_MIN four times where they do not meet. */
RUFFINI_API int ruffini_triangulate(const ruffini_pipeline* pipeline, const int32_t* places_q16, int32_t n,
                                    int32_t* out);
/* The wrench of features alone, as the frame path has it (stages/feature_wrench/feature_wrench.h): kind `wrench` of a calibration
 * for `n` features of this sort, without a board. NULL on failure. */
typedef struct ruffini_wrench ruffini_wrench;
RUFFINI_API ruffini_wrench* ruffini_wrench_open(const uint8_t* calibration, size_t calibration_bytes,
                                                const char* features, int32_t n);
RUFFINI_API void ruffini_wrench_close(ruffini_wrench* wrench);
/* Frames one after the other: features [frames][n], capture_us [frames] to wrench [frames][6] (uN, uN um), covariance
 * [frames][21] ((uN, uN mm)^2) and state [frames]: bit 0 features contradict each other, bit 1 out of range. */
RUFFINI_API int ruffini_wrench_run(ruffini_wrench* wrench, const int32_t* features, const uint64_t* capture_us,
                                   int32_t n_frames, int64_t* out, int64_t* covariance, uint8_t* state);
RUFFINI_API int ruffini_zero(ruffini_pipeline* pipeline, int32_t n_frames);
/* Rest image [height][width][3] in 1/16 grey levels, in force at once. */
RUFFINI_API int ruffini_set_rest(ruffini_pipeline* pipeline, const uint16_t* image);
/* Frames are a live camera's from the next on: repeated and broken pictures are flagged, and creep is followed. */
RUFFINI_API int ruffini_set_live(ruffini_pipeline* pipeline, int32_t is_live);
/* Of the pad, thousandths of a degree Celsius, from the next frame on; INT32_MIN: not measured. */
RUFFINI_API int ruffini_set_temperature(ruffini_pipeline* pipeline, int32_t milli_celsius);

/* The solve alone on n_frames displacements, [frame][node][3] steps of 125 nm -> [frame][node][3] force steps. */
RUFFINI_API int ruffini_solve(ruffini_pipeline* pipeline, const int16_t* displacement, int32_t n_frames,
                              int32_t* force);

/* Of the last processed frame. */
RUFFINI_API int ruffini_get_markers(const ruffini_pipeline* pipeline, int32_t* rest_q16, int32_t* displacement_q16,
                                    uint8_t* lost); /* [marker][2], [marker][2], [marker]: 1 lost, 2 absent */
/* [marker]: 255 / (1 + (expected error / 0.1 px)^2), 0 lost. 1 with ruffini_error() where they are not graded. */
RUFFINI_API int ruffini_get_marker_quality(const ruffini_pipeline* pipeline, uint8_t* out);
RUFFINI_API int ruffini_get_change(const ruffini_pipeline* pipeline, int16_t* out);       /* [h][w][3] Q12 */
RUFFINI_API int ruffini_get_slope(const ruffini_pipeline* pipeline, int16_t* out);        /* [dy][dx][2] Q12 */
RUFFINI_API int ruffini_get_depth(const ruffini_pipeline* pipeline, int16_t* out);        /* [dy][dx] 125 nm */
RUFFINI_API int ruffini_get_displacement(const ruffini_pipeline* pipeline, int16_t* out); /* [node][3] 125 nm */
RUFFINI_API int ruffini_get_force(const ruffini_pipeline* pipeline, int32_t* out);        /* [node][3] */
RUFFINI_API int ruffini_get_mask(const ruffini_pipeline* pipeline, uint8_t* out);         /* [node] */
RUFFINI_API int ruffini_get_slip(const ruffini_pipeline* pipeline, uint8_t* out); /* [node] 0 free 1 sticks 2 slips */
/* The listed contacts, largest first, [8][15]: nodes, um^2, centre x y um, force x y z uN, lowest u_z nm, SlipState,
 * 1e3 |F_t|/F_n, 1e3 friction (0: not measured), 1e3 its sigma, 1e3 slipping share, margin uN, 1: reaches
 * the window's border. *n of them. */
RUFFINI_API int ruffini_get_contacts(const ruffini_pipeline* pipeline, int64_t* out, int32_t* n);
/* Targets, [target][9]: x, y (px Q16), area (px^2 Q8), light round it (grey Q8) at rest, the same now; 1: lost. */
RUFFINI_API int ruffini_get_targets(const ruffini_pipeline* pipeline, int64_t* out);
/* How sure: standard deviations [node][3] in force steps, covariance [21] of the wrench in (uN, uN mm)^2, upper
 * triangle by rows. 1 with ruffini_error() where the last frame states none. */
RUFFINI_API int ruffini_get_sigma(const ruffini_pipeline* pipeline, int32_t* sigma, int64_t* covariance);
/* What the forces leave unexplained, [node][3] in 1/64 standard deviation (solve/support_solver.h), found when it is asked
 * for. 1 with ruffini_error() where the last frame had no second pass. */
RUFFINI_API int ruffini_get_residual(ruffini_pipeline* pipeline, int32_t* out, int32_t* validity);
/* Of the wrench alone, [21]. 1 with ruffini_error() where the last frame states none. */
RUFFINI_API int ruffini_get_covariance(const ruffini_pipeline* pipeline, int64_t* covariance);

/* Touches of a glowing skin, hardest first, [8][11]: identity, x y um, area um^2, brightness, pressing force uN and its
 * sigma, sigma of the place um, that force as a vector x y z uN. *n of them. 1 with ruffini_error() without a skin. */
RUFFINI_API int ruffini_get_touches(const ruffini_pipeline* pipeline, int64_t* out, int32_t* n);
/* What presses on a fingertip, [19]: touched, known, in range; force uN, way um, x y um, roll pitch urad, area um^2;
 * sigma of these seven; flat area um^2 and its sigma. 1 with ruffini_error() where it is not calibrated. */
RUFFINI_API int ruffini_get_tip(const ruffini_pipeline* pipeline, int64_t* row);
/* Number of its taxels, 0 without; light over that at rest less 1, and age of the light, both Q12. */
RUFFINI_API int ruffini_skin_state(const ruffini_pipeline* pipeline, int32_t* n_taxels, int64_t* light_age);
RUFFINI_API int ruffini_get_taxels(const ruffini_pipeline* pipeline, int32_t* ratio); /* [taxel] Q12 */
/* [h][w] 1/4 levels of the weighted channels over rest; smoothed where there are no taxels, else as it is. */
RUFFINI_API int ruffini_get_glow(const ruffini_pipeline* pipeline, int16_t* out);
/* Of the stage contact_model, [22]: u_r on 16 rings (1/16 um), their size (1/16 um), fall of the density (Q16), centre
 * x, y (um), lost patches (1/1000), mean flow (1/16 um). 1 with ruffini_error() without that stage. */
RUFFINI_API int ruffini_get_profile(const ruffini_pipeline* pipeline, int64_t* out);
/* Of the stage helmholtz, [3]: mean size of the curl-free flow, size of the mean of the rest (1/16 um), twist (urad);
 * flow: [patch][2] of the curl-free part (1/16 um), or null. 1 with ruffini_error() without that stage. */
RUFFINI_API int ruffini_get_helmholtz(const ruffini_pipeline* pipeline, int64_t* out, int64_t* flow);
/* [16]: touched, ContactKind, its confidence (1/1000), gel depth, press depth and their sigma (um), area, effective area
 * (um^2), H_m (Pa / um), Shore A and its sigma (1/16), 1: no model holds, Validity of depth and of hardness, mean flow (um),
 * moment by the flow (uN mm). */
RUFFINI_API int ruffini_get_contact_model(const ruffini_pipeline* pipeline, int64_t* out);

#ifdef __cplusplus
}
#endif
#endif
