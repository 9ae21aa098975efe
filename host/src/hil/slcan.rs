//! CAN frames as text over a serial port: slcan, the protocol of the LAWICEL CAN232 adapter, which
//! CANable and most other cheap adapters speak (CAN232 manual, V3, "Available CAN232 ASCII commands").

use mcdpr_firmware::drives::CanFrame;

/// Closes the channel: the adapter neither sends nor acknowledges.
pub(super) const CLOSE: &str = "C\r";
/// Opens it.
pub(super) const OPEN: &str = "O\r";

/// The command that sets a bit rate; `None` for a rate that adapters do not have.
pub(super) const fn speed(bits_per_s: u32) -> Option<&'static str> {
    Some(match bits_per_s {
        125_000 => "S4\r",
        250_000 => "S5\r",
        500_000 => "S6\r",
        1_000_000 => "S8\r",
        _ => return None,
    })
}

/// The bit rate that a command sets.
pub(super) fn speed_of(command: &str) -> Option<u32> {
    let rates = [125_000, 250_000, 500_000, 1_000_000];
    let sets = |rate: &u32| speed(*rate).is_some_and(|text| text.trim_end() == command);
    rates.into_iter().find(sets)
}

/// A data frame with an identifier of 11 bits.
pub(super) fn to_text(frame: &CanFrame) -> String {
    let length = frame.len.min(8);
    let mut text = format!("t{:03X}{length}", frame.id & 0x7FF);
    for byte in frame.data.iter().take(length.into()) {
        text += &format!("{byte:02X}");
    }
    text + "\r"
}

/// `None` for what is not such a frame: an adapter's answers, frames with 29 bits, remote frames.
pub(super) fn parse(line: &str) -> Option<CanFrame> {
    let rest = line.strip_prefix('t').filter(|rest| rest.is_ascii())?;
    let id = u16::from_str_radix(rest.get(..3)?, 16).ok()?;
    let len = rest.get(3..4)?.parse::<u8>().ok()?;
    let bytes = rest.get(4..)?;
    // An adapter with time stamps adds four digits.
    let digits = usize::from(len) * 2;
    if id > 0x7FF || len > 8 || !(bytes.len() == digits || bytes.len() == digits + 4) {
        return None;
    }
    let mut data = [0; 8];
    for (index, byte) in data.iter_mut().take(len.into()).enumerate() {
        *byte = u8::from_str_radix(bytes.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(CanFrame { id, len, data })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_those_of_the_adapters_manual() {
        // The example of the CAN232 manual: identifier 0x100, eight bytes.
        let frame = CanFrame {
            id: 0x100,
            len: 8,
            data: [0x00, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77],
        };
        assert_eq!(to_text(&frame), "t10080011223344556677\r");
        assert_eq!(parse("t10080011223344556677"), Some(frame));
        assert_eq!(parse("t10080011223344556677D6D8"), Some(frame));
        let short = CanFrame {
            id: 0x10,
            len: 0,
            data: [0; 8],
        };
        assert_eq!(parse(to_text(&short).trim_end()), Some(short));
    }

    #[test]
    fn answers_and_damaged_frames_are_none() {
        for bad in [
            "",
            "z",
            "t",
            "t1",
            "t1009",
            "t8001AA",
            "t100200",
            "t1002001",
            "tXYZ0",
            "T0000010000",
            "r1000",
            "t10\u{e9}8",
        ] {
            assert_eq!(parse(bad), None, "{bad}");
        }
        assert_eq!(speed_of("S8"), Some(1_000_000));
        assert_eq!(speed_of("S9"), None);
        assert_eq!(speed(800_000), None);
    }
}
