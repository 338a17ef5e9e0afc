/* Sutura's client: a haptic console for your own simulator. Written by cbindgen from client/capi; an example is sphere.c.
 *
 * Every function returns SUTURA_OK, SUTURA_NO_POSE, or a negative code, which sutura_last_error() puts into words. Any
 * thread may call any function with any handle, except that nobody uses a handle while or after it is closed. */

#ifndef SUTURA_H
#define SUTURA_H

#include <stdint.h>

// Done.
#define SUTURA_OK 0

// No pose came in time; not an error.
#define SUTURA_NO_POSE 1

// An argument is NULL, not finite or out of range.
#define SUTURA_BAD_ARGUMENT -1

// No such port, no permission, or nobody answers on it.
#define SUTURA_NO_CONSOLE -2

// Another program has the port, or another host the console.
#define SUTURA_BUSY -3

// Console and library are of different releases.
#define SUTURA_MISMATCH -4

// The console went away, or takes nothing any more.
#define SUTURA_GONE -5

// A defect of the library; the console disarms by itself.
#define SUTURA_DEFECT -6

// Before the first complete tick; motors off.
#define SUTURA_BOOT 0

// Motors off.
#define SUTURA_IDLE 1

// Renders contact force.
#define SUTURA_ARMED 2

// The contact is older than its horizon: its force goes to zero, gravity compensation stays.
#define SUTURA_DECAYING 3

// A latched fault; motors off until sutura_clear_fault.
#define SUTURA_FAULT 4

// Nothing.
#define SUTURA_FIXTURE_NONE 0

// A wall that pushes and never pulls.
#define SUTURA_FIXTURE_WALL 1

// A spring and a damper that hold the grip at a point.
#define SUTURA_FIXTURE_COUPLING 2

// An open session with a console.
typedef struct sutura_console sutura_console;

// What a simulator decides about its session. 0 stands for the default.
typedef struct {
  // How long the console may go on with a contact before its force fades [ms], from the pose that it was computed for;
  // 60 by default, capped at 150 by the console. Three periods of the simulator and the line's delay.
  uint32_t horizon_ms;
  // Shortest time between two contacts on the line [us]; 0 by default, 10000 for a UART of 115200 baud.
  uint32_t contact_spacing_us;
  // How long the console may take to answer [ms]; 3000 by default.
  uint32_t answer_within_ms;
} sutura_options;

// What a console says of itself.
typedef struct {
  // Name of the device, UTF-8, ends with 0.
  char name[17];
  // Control rate [Hz].
  uint16_t tick_hz;
  // 1 if motors and hand are simulated.
  uint8_t simulated;
} sutura_info;

// The console at one tick.
typedef struct {
  // Console time at which the encoders were read [us]; a contact that is sent for this pose ages from here.
  uint64_t time_us;
  // Ticks since the console booted.
  uint32_t tick;
  // Grip position [m], world frame.
  float position_m[3];
  // Grip orientation, unit quaternion (x, y, z, w); identity where the console does not sense it.
  float orientation[4];
  // Grip velocity [m/s].
  float velocity_m_per_s[3];
  // Contact force commanded on the grip in this tick [N], after all guards.
  float force_n[3];
  // SUTURA_BOOT to SUTURA_FAULT.
  uint32_t mode;
  // Latched faults, bits: 1 emergency stop, 2 not finite, 4 encoder jump, 8 overrun, 16 board, 32 out of reach,
  // 64 overspeed, 128 time base, 256 amplifier, 512 supply.
  uint32_t faults;
  // Age of the contact in use [us]; 4294967295 before the first.
  uint32_t contact_age_us;
  // Its age when it came into use [us]; 4294967295 before the first.
  uint32_t applied_age_us;
  // Sequence of the frame that brought it; 0 before the first.
  uint32_t contact_sequence;
} sutura_pose;

// Contact of the grip at one pose. The console goes on from it by itself until the next one.
typedef struct {
  // Force on the grip at that pose [N], world frame.
  float force_n[3];
  // Moment on the grip about itself [N m]; consoles with three motors render none.
  float moment_nm[3];
  // d (force, moment) / d (position, rotation vector) [N/m, N, N m/rad], by rows; of a spring that pushes back the
  // diagonal is negative. While gap_m > 0: just after touching.
  float tangent[6][6];
  // Way along -normal until the grip touches [m]; 0 in contact.
  float gap_m;
  // Unit vector out of what is touched: a force against it is not rendered.
  float normal[3];
  // Rate at which the force relaxes at a held pose [1/s]; 0 for most.
  float relaxation_per_s;
} sutura_contact;

// Something fixed in space that the console renders by itself. Stiffness and damping are capped at what the device can
// render stably.
typedef struct {
  // SUTURA_FIXTURE_NONE, _WALL or _COUPLING.
  uint32_t kind;
  // A point of the wall's surface, or where the coupling holds [m].
  float point_m[3];
  // Unit vector out of the wall.
  float normal[3];
  // [N/m].
  float stiffness_n_per_m;
  // [N s/m].
  float damping_n_s_per_m;
} sutura_fixture;

// A point on a simulated hand's path.
typedef struct {
  // Time since the hand took hold [s], not decreasing.
  float time_s;
  // Where the hand wants the grip to be [m].
  float position_m[3];
} sutura_way_point;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Opens a session with the console on a serial port or pseudo-terminal and gives its handle in `console`, which
// sutura_close takes back. `options` may be NULL for the defaults.
//
// # Safety
// `port` is a string that ends with 0; `options` is NULL or points to options; `console` points to a place for a
// handle.
int32_t sutura_open(const char *port,
                    const sutura_options *options,
                    sutura_console **console);

// Disarms the console, ends the session and frees the handle. NULL is allowed and does nothing.
//
// # Safety
// `console` is NULL or a handle of sutura_open that has not been closed, and nobody uses it any more.
int32_t sutura_close(sutura_console *console);

// What the console said of itself.
//
// # Safety
// `console` is an open handle; `info` points to a place for the answer.
int32_t sutura_read_info(const sutura_console *console, sutura_info *info);

// Turns the motors on. The first force after it is 0 and grows from there.
//
// # Safety
// `console` is an open handle.
int32_t sutura_arm(const sutura_console *console);

// Turns the motors off.
//
// # Safety
// `console` is an open handle.
int32_t sutura_disarm(const sutura_console *console);

// Leaves a latched fault whose cause is gone; the console stays disarmed.
//
// # Safety
// `console` is an open handle.
int32_t sutura_clear_fault(const sutura_console *console);

// The newest pose that was not read yet. Waits for one up to `timeout_ms`; SUTURA_NO_POSE if none came.
//
// # Safety
// `console` is an open handle; `pose` points to a place for the answer.
int32_t sutura_read_pose(const sutura_console *console, uint32_t timeout_ms, sutura_pose *pose);

// Where the grip will be, across the contact's `normal`, while what is solved for `pose` is in use, with a contact every `period_us`:
// solve for this pose and send it with the contact, and strokes over round bodies are rendered from both sides. Without a contact, a normal of
// (0, 0, 0), it is `pose`. `ahead` may be `pose`.
//
// # Safety
// `console` is an open handle; `pose` points to a pose, `normal` to 3 numbers, `ahead` to a place for the answer.
int32_t sutura_ahead(const sutura_console *console,
                     const sutura_pose *pose,
                     const float *normal,
                     uint32_t period_us,
                     sutura_pose *ahead);

// Sends the contact that was computed for `pose`, in the place of one that still waits to be sent.
//
// # Safety
// `console` is an open handle; `pose` and `contact` point to what they say.
int32_t sutura_send_contact(const sutura_console *console,
                            const sutura_pose *pose,
                            const sutura_contact *contact);

// Sends a plain force [N], (3): the console holds it until the next one, whatever the grip does. Give a contact with its
// stiffness wherever it is known.
//
// # Safety
// `console` is an open handle; `pose` points to a pose, `force_n` to 3 numbers.
int32_t sutura_send_force(const sutura_console *console,
                          const sutura_pose *pose,
                          const float *force_n);

// Puts up, changes or takes down what the console renders by itself, with or without contacts.
//
// # Safety
// `console` is an open handle; `fixture` points to one.
int32_t sutura_set_fixture(const sutura_console *console, const sutura_fixture *fixture);

// Gives a simulated console a hand that pulls the grip along a path of `count` points (1 to 12) by a spring and a
// damper, from now on. A console with motors refuses this.
//
// # Safety
// `console` is an open handle; `points` points to `count` points.
int32_t sutura_set_hand(const sutura_console *console,
                        float stiffness_n_per_m,
                        float damping_n_s_per_m,
                        const sutura_way_point *points,
                        uint32_t count);

// Why the last call of this thread that failed did so, and what to do about it; a string that is valid until the
// thread's next call. Empty if none has failed.
const char *sutura_last_error(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SUTURA_H */
