//! NatNet, the protocol of OptiTrack's Motive, versions 3.0 to 4: frames of motion-capture data.
//!
//! A packet is its message number and the length of its payload, both `u16`, then the payload; all
//! values are little-endian. A frame has its number, then sections (marker sets, other markers,
//! rigid bodies, skeletons, from 4.1 on assets, labelled markers, force plates, devices). Each
//! section has its count, from 4.1 on followed by its length in bytes. The stamps are at the end.
//! Only rigid bodies and stamps are read; the rest is skipped.

use super::sample::{Malformed, Sample};

/// Motive's port for commands.
pub const COMMAND_PORT: u16 = 1510;
/// Length of the names in a server's description.
const NAME_LEN: usize = 256;
/// Most bodies in a frame; more means that it is not a frame.
const BODIES_MAX: usize = 4096;
/// Bit of a body's parameters: the body is tracked in this frame.
const TRACKED: u16 = 1;

/// Message numbers.
mod id {
    pub(super) const CONNECT: u16 = 0;
    pub(super) const SERVER_INFO: u16 = 1;
    pub(super) const FRAME: u16 = 7;
    pub(super) const KEEP_ALIVE: u16 = 10;
}

/// Version of the frame layout, major and minor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// The major version: 3 or 4.
    pub major: u8,
    /// The minor version, such as 1 in 4.1.
    pub minor: u8,
}

impl Version {
    const FIRST: Self = Self { major: 3, minor: 0 };
    /// From here on, sections carry their length, and assets are a section.
    const SIZED: Self = Self { major: 4, minor: 1 };
}

/// The content of a packet.
#[derive(Clone, Debug, PartialEq)]
pub enum Packet {
    /// The bodies of a frame.
    Frame(Vec<Sample>),
    /// The server's description of itself.
    Server {
        /// The layout of its frames.
        version: Version,
    },
    /// A packet that is not needed.
    Other,
}

/// Decodes the packets of one server.
#[derive(Clone, Debug)]
pub struct Decoder {
    version: Version,
    /// Frequency of the server's clock, ticks per second.
    ticks_hz: Option<u64>,
    /// Whether stamps are ticks, as the first frame decided: a stream uses one clock.
    counts_ticks: Option<bool>,
}

impl Decoder {
    /// A decoder of frames of `version`, until the server reports a different one.
    pub fn new(version: Version) -> Self {
        Self { version, ticks_hz: None, counts_ticks: None }
    }

    /// Decodes a datagram.
    ///
    /// # Errors
    /// [`Malformed`]: it is not a packet of this version.
    pub fn datagram(&mut self, bytes: &[u8]) -> Result<Packet, Malformed> {
        let mut packet = Reader { bytes };
        let (message, length) = (packet.u16()?, packet.u16()?);
        let mut payload = Reader { bytes: packet.take(length.into())? };
        match message {
            id::SERVER_INFO => self.server(&mut payload),
            id::FRAME => self.frame(&mut payload),
            _ => Ok(Packet::Other),
        }
    }

    /// Name, program version, NatNet version, and the frequency of the server's clock where it has
    /// one.
    fn server(&mut self, payload: &mut Reader<'_>) -> Result<Packet, Malformed> {
        payload.take(NAME_LEN + 4)?;
        let [major, minor, _, _] = payload.array()?;
        let version = Version { major, minor };
        if version < Version::FIRST {
            return Err(Malformed(format!(
                "NatNet {major}.{minor}: expected 3.0 or newer; update Motive"
            )));
        }
        self.version = version;
        self.ticks_hz = payload.u64().ok().filter(|hz| *hz > 0);
        Ok(Packet::Server { version })
    }

    fn frame(&mut self, frame: &mut Reader<'_>) -> Result<Packet, Malformed> {
        let version = self.version;
        let sized = version >= Version::SIZED;
        frame.take(4)?;
        frame.section(sized, |set| {
            set.text()?;
            set.items(12)
        })?;
        frame.section(sized, |marker| marker.take(12).map(drop))?;
        let mut samples = Vec::new();
        let count = frame.count()?;
        if sized {
            frame.take(4)?;
        }
        if count > BODIES_MAX {
            return Err(Malformed(format!("{count} rigid bodies in a frame")));
        }
        for _ in 0..count {
            samples.push(body(frame)?);
        }
        frame.section(sized, |skeleton| {
            skeleton.take(4)?;
            skeleton.items(38)
        })?;
        if sized {
            frame.section(sized, |_| Ok(()))?;
        }
        frame.section(sized, |marker| marker.take(26).map(drop))?;
        for _ in ["force plates", "devices"] {
            frame.section(sized, |plate| {
                plate.take(4)?;
                for _ in 0..plate.count()? {
                    plate.items(4)?;
                }
                Ok(())
            })?;
        }
        let (captured_s, sent_s) = self.stamps(frame)?;
        for sample in &mut samples {
            (sample.captured_s, sample.sent_s) = (captured_s, sent_s);
        }
        Ok(Packet::Frame(samples))
    }

    /// When the frame was exposed and sent, s: from ticks of the server's clock where their
    /// frequency is known, else the frame's own stamp.
    fn stamps(&mut self, frame: &mut Reader<'_>) -> Result<(f64, Option<f64>), Malformed> {
        frame.take(8)?;
        let stamp_s = f64::from_le_bytes(frame.array()?);
        let exposed = frame.u64()?;
        frame.take(8)?;
        let sent = frame.u64()?;
        let counts = *self.counts_ticks.get_or_insert(self.ticks_hz.is_some() && exposed > 0);
        match self.ticks_hz.filter(|_| counts) {
            Some(hz) => {
                let seconds = |ticks: u64| ticks as f64 / hz as f64;
                Ok((seconds(exposed), Some(seconds(sent)).filter(|_| sent >= exposed)))
            }
            None => Ok((stamp_s, None)),
        }
    }
}

/// Number, position, rotation x, y, z, w, mean marker error, parameters.
fn body(frame: &mut Reader<'_>) -> Result<Sample, Malformed> {
    let number = i32::from_le_bytes(frame.array()?);
    let mut values = [0.0; 7];
    for value in &mut values {
        *value = f64::from(f32::from_le_bytes(frame.array()?));
    }
    frame.take(4)?;
    let parameters = frame.u16()?;
    let [px, py, pz, x, y, z, w] = values;
    Ok(Sample {
        body: number.to_string(),
        captured_s: f64::NAN,
        sent_s: None,
        position_m: [px, py, pz],
        rotation: [w, x, y, z],
        is_tracked: parameters & TRACKED != 0,
    })
}

/// The packet that requests a server's description, and the frames of a unicast server.
pub fn connect() -> Vec<u8> {
    // Name and versions of the client, then: frames in the server's own version, all data.
    let mut payload = vec![0; NAME_LEN + 8 + 6];
    let name = b"downwash";
    payload.iter_mut().zip(name).for_each(|(to, from)| *to = *from);
    packet(id::CONNECT, &payload)
}

/// The packet that keeps a unicast server sending.
pub fn keep_alive() -> Vec<u8> {
    packet(id::KEEP_ALIVE, &[])
}

fn packet(message: u16, payload: &[u8]) -> Vec<u8> {
    let length = payload.len() as u16;
    [&message.to_le_bytes()[..], &length.to_le_bytes(), payload].concat()
}

/// The unread rest of a packet.
struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], Malformed> {
        let (taken, left) = self.bytes.split_at_checked(length).ok_or_else(|| {
            Malformed(
                "a packet that ends early; does mocap.natnet_version match Motive?".to_owned(),
            )
        })?;
        self.bytes = left;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn u16(&mut self) -> Result<u16, Malformed> {
        self.array().map(u16::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, Malformed> {
        self.array().map(u64::from_le_bytes)
    }

    fn count(&mut self) -> Result<usize, Malformed> {
        let count = i32::from_le_bytes(self.array()?);
        usize::try_from(count).map_err(|_| Malformed(format!("a count of {count}")))
    }

    /// Skips a count and as many items of `length` bytes.
    fn items(&mut self, length: usize) -> Result<(), Malformed> {
        let count = self.count()?;
        let bytes = count.saturating_mul(length);
        self.take(bytes).map(drop)
    }

    /// Skips a zero-terminated text.
    fn text(&mut self) -> Result<(), Malformed> {
        let length = self.bytes.iter().position(|byte| *byte == 0);
        self.take(length.unwrap_or(usize::MAX - 1) + 1).map(drop)
    }

    /// Skips a section: by its length, or item by item.
    fn section(
        &mut self,
        sized: bool,
        item: impl Fn(&mut Self) -> Result<(), Malformed>,
    ) -> Result<(), Malformed> {
        let count = self.count()?;
        if sized {
            let length = self.count()?;
            return self.take(length).map(drop);
        }
        // An item takes at least a byte, so an absurd count ends with the packet.
        (0..count).try_for_each(|_| item(self))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const V31: Version = Version { major: 3, minor: 1 };
    const V41: Version = Version { major: 4, minor: 1 };

    /// A frame in the published layout, with one of everything before and after the bodies.
    fn frame(version: Version, bodies: &[(i32, [f32; 7], u16)]) -> Vec<u8> {
        let sized = version >= Version::SIZED;
        let mut out = 77i32.to_le_bytes().to_vec();
        let mut section = |count: i32, content: Vec<u8>| {
            out.extend(count.to_le_bytes());
            if sized {
                out.extend((content.len() as i32).to_le_bytes());
            }
            out.extend(content);
        };
        section(1, [&b"all\0"[..], &2i32.to_le_bytes(), &[0; 24]].concat());
        section(3, vec![0; 36]);
        let rigid = |(number, pose, parameters): &(i32, [f32; 7], u16)| {
            let mut bytes = number.to_le_bytes().to_vec();
            pose.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
            bytes.extend(0.0003f32.to_le_bytes());
            bytes.extend(parameters.to_le_bytes());
            bytes
        };
        section(bodies.len() as i32, bodies.iter().flat_map(rigid).collect());
        // A skeleton of two bones.
        section(1, [&9i32.to_le_bytes()[..], &2i32.to_le_bytes(), &[0; 76]].concat());
        if sized {
            section(0, Vec::new());
        }
        section(2, vec![0; 52]);
        let channel = [&3i32.to_le_bytes()[..], &1i32.to_le_bytes(), &2i32.to_le_bytes(), &[0; 8]];
        section(1, channel.concat());
        section(1, channel.concat());
        out.extend([0; 8]);
        out.extend(12.5f64.to_le_bytes());
        for ticks in [1_000_000u64, 1_000_400, 1_000_900] {
            out.extend(ticks.to_le_bytes());
        }
        if version.major >= 4 {
            out.extend([0; 8]);
        }
        out.extend([0; 6]);
        packet(id::FRAME, &out)
    }

    fn server(version: Version, hz: u64) -> Vec<u8> {
        let mut payload = vec![0; NAME_LEN + 4];
        payload.extend([version.major, version.minor, 0, 0]);
        payload.extend(hz.to_le_bytes());
        payload.extend([0; 7]);
        packet(id::SERVER_INFO, &payload)
    }

    #[test]
    fn bodies_and_timestamps_are_found_among_other_data() {
        for version in [V31, Version { major: 4, minor: 0 }, V41] {
            let sent = [(1, [1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], 1), (7, [0.0; 7], 0)];
            let Ok(Packet::Frame(found)) = Decoder::new(version).datagram(&frame(version, &sent))
            else {
                panic!("{version:?}")
            };
            let [first, second] = found.as_slice() else { panic!("{found:?}") };
            assert_eq!((first.body.as_str(), first.position_m), ("1", [1.0, 2.0, 3.0]));
            assert!(
                (first.rotation[0] - 0.8).abs() < 1e-6 && (first.rotation[3] - 0.6).abs() < 1e-6
            );
            assert_eq!((first.captured_s, first.sent_s, first.is_tracked), (12.5, None, true));
            assert_eq!((second.body.as_str(), second.is_tracked), ("7", false));
        }
    }

    #[test]
    fn server_info_sets_version_and_rate_without_changing_the_clock() {
        let mut decoder = Decoder::new(V31);
        let decoded = decoder.datagram(&server(V41, 1_000_000));
        assert_eq!(decoded, Ok(Packet::Server { version: V41 }));
        let one = [(1, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 1)];
        let Ok(Packet::Frame(found)) = decoder.datagram(&frame(V41, &one)) else { panic!() };
        assert_eq!((found[0].captured_s, found[0].sent_s), (1.0, Some(1.0009)));

        let mut decoder = Decoder::new(V41);
        decoder.datagram(&frame(V41, &one)).expect("a frame");
        decoder.datagram(&server(V41, 1_000_000)).expect("a server");
        let Ok(Packet::Frame(found)) = decoder.datagram(&frame(V41, &one)) else { panic!() };
        assert_eq!(found[0].captured_s, 12.5, "its clock does not change");
    }

    #[test]
    fn unsupported_natnet_versions_are_refused() {
        let old = Decoder::new(V31).datagram(&server(Version { major: 2, minor: 10 }, 1));
        assert!(old.expect_err("too old").to_string().contains("update Motive"));
        let one = [(1, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 1)];
        assert!(Decoder::new(V31).datagram(&frame(V41, &one)).is_err());
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic_the_parser(
            message in prop::sample::select(vec![id::SERVER_INFO, id::FRAME, 5, 100]),
            bytes in prop::collection::vec(any::<u8>(), 0..600),
            sized in any::<bool>(),
        ) {
            let mut decoder = Decoder::new(if sized { V41 } else { V31 });
            let _ = decoder.datagram(&bytes);
            let _ = decoder.datagram(&packet(message, &bytes));
        }

        #[test]
        fn damaged_frame_never_panics_the_decoder(
            at in any::<prop::sample::Index>(), byte in any::<u8>(), cut in any::<prop::sample::Index>(),
            sized in any::<bool>(),
        ) {
            let version = if sized { V41 } else { V31 };
            let complete = frame(version, &[(1, [0.5; 7], 1), (2, [0.5; 7], 1)]);
            let mut bytes = complete.clone();
            bytes[at.index(complete.len())] = byte;
            let _ = Decoder::new(version).datagram(&bytes);
            let short = &complete[..cut.index(complete.len())];
            prop_assert!(Decoder::new(version).datagram(short).is_err());
        }
    }
}
