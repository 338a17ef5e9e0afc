//! What the line carries: how many rows a contact may have at a rate of frames.
//!
//! Entry point: [`most_rows`]. The states of the console come first, then the contact, at the rate that the host was
//! asked for; rows have what is left.

use sutura_shared::control::TICK_HZ;
use sutura_shared::wire::message::MAX_ROWS;
use sutura_shared::wire::{MAX_CONTACT_FRAME, MAX_STATE_FRAME, frame_size};

/// What USB at full speed is good for, both ways together \[bytes/s\]: half of its 1.2 MB/s, as hosts leave slots empty.
pub const LINE_BYTES_PER_S: f64 = 600e3;
/// Bytes of a smooth row whose node's number has up to three bytes (2 million nodes): kind, id, delta_free, lambda, J.
const ROW: usize = 1 + 3 + 4 + 4 + 6 * 4;
/// Bytes of a body without rows: tool, M, curvature, and the lengths of the two lists.
const BODY: usize = 1 + 21 * 4 + 4 + 1 + 2;
/// Fewer rows than these foresee less than the tangent, in which all of them are: of a contact of 20 vertices 16 rows are
/// nearly as good as 24, and 8 are worse than none (`sutura fidelity --full --only "errors palpation rows"`).
const LEAST_ROWS: usize = 12;

/// Bytes of a frame with so many smooth rows.
fn rows_frame_size(rows: usize) -> usize {
    frame_size(BODY + rows * ROW + rows * (rows + 1) / 2 * 4)
}

/// What USB and the board at its end take, both ways together \[bytes/s\]. `board_rows_hz`: how many frames of all rows and their contacts the
/// board has time for in a second, beside a state in every tick; such a frame costs it by the byte. None: whatever comes.
pub fn usb_bytes_per_s(board_rows_hz: Option<f64>) -> f64 {
    let frame = rows_frame_size(MAX_ROWS) + MAX_CONTACT_FRAME;
    let states = f64::from(TICK_HZ) * MAX_STATE_FRAME as f64;
    let board = board_rows_hz.map_or(f64::INFINITY, |hz| states + hz * frame as f64);
    board.min(LINE_BYTES_PER_S)
}

/// Most rows that a contact may have on a line that carries `bytes_per_s`, with `host_hz` contacts and `state_hz`
/// states a second; 0 if it would be too few to be of use.
pub fn most_rows(bytes_per_s: f64, host_hz: f64, state_hz: f64) -> usize {
    let states = state_hz * MAX_STATE_FRAME as f64;
    let left = (bytes_per_s - states) / host_hz - MAX_CONTACT_FRAME as f64;
    let fits = |rows: &usize| rows_frame_size(*rows) as f64 <= left;
    (LEAST_ROWS..=MAX_ROWS).rev().find(fits).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_rows_up_to_190_hz_and_the_tangent_alone_at_1_khz() {
        let usb = |host_hz| most_rows(LINE_BYTES_PER_S, host_hz, 1000.0);
        assert_eq!([30.0, 60.0, 100.0, 190.0].map(usb), [24; 4]);
        assert_eq!(usb(200.0), 23);
        assert_eq!(usb(1000.0), 0);
        let mut before = 24;
        for hz in 200..=1000 {
            let rows = usb(f64::from(hz));
            assert!(rows <= before, "{hz} Hz: {rows} rows");
            before = rows;
        }
        // Rows go before rate: half of them where there is half as much room for W.
        assert!((10..=20).contains(&usb(350.0)), "{}", usb(350.0));
    }

    /// Whatever is said to fit does, counted in bytes a second.
    #[test]
    fn what_fits_is_within_the_line() {
        for hz in 1..=1000 {
            let host_hz = f64::from(hz);
            let rows = most_rows(LINE_BYTES_PER_S, host_hz, 1000.0);
            let down = 186.0
                + if rows > 0 {
                    rows_frame_size(rows) as f64
                } else {
                    0.0
                };
            let sum = 143.0 * 1000.0 + down * host_hz;
            assert!(sum <= LINE_BYTES_PER_S, "{hz} Hz: {sum} bytes/s");
        }
    }

    #[test]
    fn a_board_that_takes_whatever_comes_leaves_the_line_as_it_is() {
        for hz in [None, Some(1000.0)] {
            assert_eq!(usb_bytes_per_s(hz), LINE_BYTES_PER_S);
        }
    }

    /// All rows up to its rate and no faster, and fewer, as long as they are of use, beyond it.
    #[test]
    fn a_board_has_time_for_what_its_file_says() {
        for rows_hz in [30.0, 100.0, 180.0] {
            let most = |host_hz| most_rows(usb_bytes_per_s(Some(rows_hz)), host_hz, 1000.0);
            assert_eq!([1.0, 0.5].map(|part| most(part * rows_hz)), [MAX_ROWS; 2]);
            assert!((LEAST_ROWS..MAX_ROWS).contains(&most(1.05 * rows_hz)));
            assert_eq!(most(4.0 * rows_hz), 0);
            let mut before = MAX_ROWS;
            for hz in 1..=1000 {
                let rows = most(f64::from(hz));
                assert!(rows <= before, "{hz} Hz: {rows} rows");
                before = rows;
            }
        }
    }

    #[test]
    fn a_serial_line_has_no_room_for_rows() {
        assert_eq!(most_rows(8e3, 30.0, 100.0), 0);
        assert_eq!(most_rows(0.0, 1.0, 0.0), 0);
    }
}
