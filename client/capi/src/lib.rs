//! Sutura's client for C and everything that calls C. The header is client/c/sutura.h, an example client/c/sphere.c.
//!
//! Entry point: [`sutura_open`]. Every function returns a code, no panic gets out, and any thread may call any function
//! with any handle, except that nobody uses a handle while or after it is closed.
#![allow(
    unsafe_code,
    reason = "C hands over pointers: each use says why it is sound"
)]
#![allow(
    rustdoc::broken_intra_doc_links,
    reason = "units, as the header has them"
)]

mod error;
mod types;

pub use error::*;
pub use types::*;

use error::{Refusal, guarded, last};
use std::ffi::{CStr, c_char};
use std::time::Duration;
use sutura_client::message::{Fixture, HandScript, Simulate, WAY_POINTS, WayPoint};
use sutura_client::{Console, Contact, Options, Pose};

/// An open session with a console.
pub struct SuturaConsole {
    console: Console,
}

/// Opens a session with the console on a serial port or pseudo-terminal and gives its handle in `console`, which
/// sutura_close takes back. `options` may be NULL for the defaults.
///
/// # Safety
/// `port` is a string that ends with 0; `options` is NULL or points to options; `console` points to a place for a
/// handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_open(
    port: *const c_char,
    options: *const SuturaOptions,
    console: *mut *mut SuturaConsole,
) -> i32 {
    guarded(|| {
        if port.is_null() || console.is_null() {
            return Err(Refusal::null("port or console"));
        }
        // SAFETY: not NULL, and the caller promises a place for a handle.
        unsafe { console.write(std::ptr::null_mut()) };
        // SAFETY: not NULL, and the caller promises a string that ends with 0.
        let port = unsafe { CStr::from_ptr(port) };
        let port = port
            .to_str()
            .map_err(|_| Refusal::argument("the port's name is not UTF-8"))?;
        // SAFETY: NULL, or options as the caller promises; they are plain numbers, of which all bits are values.
        let options = unsafe { options.as_ref() }.map_or_else(Options::default, Options::from);
        let opened = Box::new(SuturaConsole {
            console: Console::open(port, options)?,
        });
        // SAFETY: as above.
        unsafe { console.write(Box::into_raw(opened)) };
        Ok(SUTURA_OK)
    })
}

/// Disarms the console, ends the session and frees the handle. NULL is allowed and does nothing.
///
/// # Safety
/// `console` is NULL or a handle of sutura_open that has not been closed, and nobody uses it any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_close(console: *mut SuturaConsole) -> i32 {
    guarded(|| {
        if !console.is_null() {
            // SAFETY: sutura_open made it with Box::into_raw, and the caller promises that this is its only end.
            let handle = unsafe { Box::from_raw(console) };
            handle.console.close();
        }
        Ok(SUTURA_OK)
    })
}

/// What the console said of itself.
///
/// # Safety
/// `console` is an open handle; `info` points to a place for the answer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_read_info(
    console: *const SuturaConsole,
    info: *mut SuturaInfo,
) -> i32 {
    // SAFETY: the caller promises an open handle.
    with(unsafe { console.as_ref() }, |console| {
        let hello = console.info();
        let said = SuturaInfo {
            // A name may fill its 16 bytes: the 17th ends it.
            name: std::array::from_fn(|i| {
                hello.device_name.get(i).map_or(0, |byte| *byte as c_char)
            }),
            tick_hz: hello.tick_hz,
            simulated: u8::from(hello.simulated),
        };
        // SAFETY: NULL, or a place for the answer as the caller promises.
        unsafe { give(info, said) }
    })
}

/// Turns the motors on. The first force after it is 0 and grows from there.
///
/// # Safety
/// `console` is an open handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_arm(console: *const SuturaConsole) -> i32 {
    // SAFETY: the caller promises an open handle.
    with(unsafe { console.as_ref() }, |console| done(console.arm()))
}

/// Turns the motors off.
///
/// # Safety
/// `console` is an open handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_disarm(console: *const SuturaConsole) -> i32 {
    // SAFETY: the caller promises an open handle.
    with(unsafe { console.as_ref() }, |console| {
        done(console.disarm())
    })
}

/// Leaves a latched fault whose cause is gone; the console stays disarmed.
///
/// # Safety
/// `console` is an open handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_clear_fault(console: *const SuturaConsole) -> i32 {
    // SAFETY: the caller promises an open handle.
    with(unsafe { console.as_ref() }, |console| {
        done(console.clear_fault())
    })
}

/// The newest pose that was not read yet. Waits for one up to `timeout_ms`; SUTURA_NO_POSE if none came.
///
/// # Safety
/// `console` is an open handle; `pose` points to a place for the answer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_read_pose(
    console: *const SuturaConsole,
    timeout_ms: u32,
    pose: *mut SuturaPose,
) -> i32 {
    // SAFETY: the caller promises an open handle.
    with(unsafe { console.as_ref() }, |console| {
        match console.pose(Duration::from_millis(u64::from(timeout_ms)))? {
            // SAFETY: NULL, or a place for the answer as the caller promises.
            Some(newest) => unsafe { give(pose, SuturaPose::from(&newest)) },
            None => Ok(SUTURA_NO_POSE),
        }
    })
}

/// Where the grip will be, across the contact's `normal`, while what is solved for `pose` is in use, with a contact every `period_us`:
/// solve for this pose and send it with the contact, and strokes over round bodies are rendered from both sides. Without a contact, a normal of
/// (0, 0, 0), it is `pose`. `ahead` may be `pose`.
///
/// # Safety
/// `console` is an open handle; `pose` points to a pose, `normal` to 3 numbers, `ahead` to a place for the answer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_ahead(
    console: *const SuturaConsole,
    pose: *const SuturaPose,
    normal: *const f32,
    period_us: u32,
    ahead: *mut SuturaPose,
) -> i32 {
    // SAFETY: the caller promises an open handle, a pose and 3 numbers; an array is aligned as its items are.
    let (console, pose, normal) = unsafe {
        (
            console.as_ref(),
            pose.as_ref(),
            normal.cast::<[f32; 3]>().as_ref(),
        )
    };
    with(console, |console| {
        let pose = Pose::from(pose.ok_or_else(|| Refusal::null("pose"))?);
        let normal = *normal.ok_or_else(|| Refusal::null("normal"))?;
        let period = Duration::from_micros(u64::from(period_us));
        let there = console.ahead(&pose, normal, period);
        // SAFETY: NULL, or a place for the answer as the caller promises.
        unsafe { give(ahead, SuturaPose::from(&there)) }
    })
}

/// Sends the contact that was computed for `pose`, in the place of one that still waits to be sent.
///
/// # Safety
/// `console` is an open handle; `pose` and `contact` point to what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_send_contact(
    console: *const SuturaConsole,
    pose: *const SuturaPose,
    contact: *const SuturaContact,
) -> i32 {
    // SAFETY: the caller promises an open handle, and pointers to plain numbers, of which all bits are values.
    let (console, pose, contact) = unsafe { (console.as_ref(), pose.as_ref(), contact.as_ref()) };
    with(console, |console| {
        let pose = Pose::from(pose.ok_or_else(|| Refusal::null("pose"))?);
        let contact = Contact::from(contact.ok_or_else(|| Refusal::null("contact"))?);
        done(console.send_contact(&pose, &contact))
    })
}

/// Sends a plain force [N], (3): the console holds it until the next one, whatever the grip does. Give a contact with its
/// stiffness wherever it is known.
///
/// # Safety
/// `console` is an open handle; `pose` points to a pose, `force_n` to 3 numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_send_force(
    console: *const SuturaConsole,
    pose: *const SuturaPose,
    force_n: *const f32,
) -> i32 {
    // SAFETY: the caller promises an open handle, a pose and 3 numbers; an array is aligned as its items are.
    let (console, pose, force_n) = unsafe {
        (
            console.as_ref(),
            pose.as_ref(),
            force_n.cast::<[f32; 3]>().as_ref(),
        )
    };
    with(console, |console| {
        let pose = Pose::from(pose.ok_or_else(|| Refusal::null("pose"))?);
        let force_n = *force_n.ok_or_else(|| Refusal::null("force_n"))?;
        done(console.send_force(&pose, force_n))
    })
}

/// Puts up, changes or takes down what the console renders by itself, with or without contacts.
///
/// # Safety
/// `console` is an open handle; `fixture` points to one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_set_fixture(
    console: *const SuturaConsole,
    fixture: *const SuturaFixture,
) -> i32 {
    // SAFETY: the caller promises an open handle, and a pointer to plain numbers, of which all bits are values.
    let (console, fixture) = unsafe { (console.as_ref(), fixture.as_ref()) };
    with(console, |console| {
        let given = fixture.ok_or_else(|| Refusal::null("fixture"))?;
        let (stiffness_n_per_m, damping_n_s_per_m) =
            (given.stiffness_n_per_m, given.damping_n_s_per_m);
        let fixture = match given.kind {
            SUTURA_FIXTURE_NONE => Fixture::None,
            SUTURA_FIXTURE_WALL => Fixture::Wall {
                point_m: given.point_m,
                normal: given.normal,
                stiffness_n_per_m,
                damping_n_s_per_m,
            },
            SUTURA_FIXTURE_COUPLING => Fixture::Coupling {
                anchor_m: given.point_m,
                stiffness_n_per_m,
                damping_n_s_per_m,
            },
            kind => {
                let message =
                    format!("there is no fixture of kind {kind}: 0 none, 1 wall, 2 coupling");
                return Err(Refusal::argument(&message));
            }
        };
        done(console.fixture(&fixture))
    })
}

/// Gives a simulated console a hand that pulls the grip along a path of `count` points (1 to 12) by a spring and a
/// damper, from now on. A console with motors refuses this.
///
/// # Safety
/// `console` is an open handle; `points` points to `count` points.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sutura_set_hand(
    console: *const SuturaConsole,
    stiffness_n_per_m: f32,
    damping_n_s_per_m: f32,
    points: *const SuturaWayPoint,
    count: u32,
) -> i32 {
    // SAFETY: the caller promises an open handle.
    with(unsafe { console.as_ref() }, |console| {
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        if points.is_null() {
            return Err(Refusal::null("points"));
        }
        if !(1..=WAY_POINTS).contains(&count) {
            let message = format!("a hand has 1 to {WAY_POINTS} points, not {count}");
            return Err(Refusal::argument(&message));
        }
        // SAFETY: not NULL, and the caller promises `count` points, which are few.
        let points = unsafe { std::slice::from_raw_parts(points, count) };
        let mut way_points = [WayPoint::default(); WAY_POINTS];
        for (to, from) in way_points.iter_mut().zip(points) {
            *to = WayPoint {
                time_s: from.time_s,
                position_m: from.position_m,
            };
        }
        let hand = HandScript {
            stiffness_n_per_m,
            damping_n_s_per_m,
            // On the stages of the built-in console joint coordinates are places.
            start_joint: points.first().map_or([0.0; 3], |point| point.position_m),
            count: u8::try_from(count).unwrap_or(u8::MAX),
            way_points,
        };
        done(console.simulate(&Simulate::Hand(hand)))
    })
}

/// Why the last call of this thread that failed did so, and what to do about it; a string that is valid until the
/// thread's next call. Empty if none has failed.
#[unsafe(no_mangle)]
pub extern "C" fn sutura_last_error() -> *const c_char {
    last()
}

/// Runs a call on a handle.
fn with(
    console: Option<&SuturaConsole>,
    call: impl FnOnce(&Console) -> Result<i32, Refusal>,
) -> i32 {
    guarded(|| call(&console.ok_or_else(|| Refusal::null("console"))?.console))
}

fn done(result: Result<(), sutura_client::Error>) -> Result<i32, Refusal> {
    result.map(|()| SUTURA_OK).map_err(Refusal::from)
}

/// Writes an answer.
///
/// # Safety
/// `place` is NULL or points to a place for it.
unsafe fn give<T>(place: *mut T, value: T) -> Result<i32, Refusal> {
    if place.is_null() {
        return Err(Refusal::null("the place for the answer"));
    }
    // SAFETY: not NULL, and a place as the caller promises.
    unsafe { place.write(value) };
    Ok(SUTURA_OK)
}
