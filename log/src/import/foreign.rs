//! Identifies files that are often mistaken for flight logs.

/// First bytes of a file, what it is, and what to do.
const MAGICS: [(&[u8], &str); 23] = [
    (
        b"ULogEnc",
        "an encrypted log of PX4 (.ulge): decrypt it with PX4's tools and the private key of the vehicle \
         first",
    ),
    (b"PK\x03\x04", "a compressed file (zip): unpack it first"),
    (b"\x1F\x8B", "a compressed file (gzip): unpack it first"),
    (b"\xFD7zXZ\0", "a compressed file (xz): unpack it first"),
    (b"BZh", "a compressed file (bzip2): unpack it first"),
    (b"7z\xBC\xAF\x27\x1C", "a compressed file (7z): unpack it first"),
    (b"\x28\xB5\x2F\xFD", "a compressed file (zstd): unpack it first"),
    (b"\x04\x22\x4D\x18", "a compressed file (lz4): unpack it first"),
    (b"Rar!\x1A\x07", "a compressed file (rar): unpack it first"),
    (b"\x1F\x9D", "a compressed file (compress, .Z): unpack it first"),
    (b"\x93NUMPY", "a NumPy array: export it as a table (.csv)"),
    (
        b"\xD0\xCF\x11\xE0\xA1\xB1\x1A\xE1",
        "a document of Microsoft Office: save the sheet as a table (.csv)",
    ),
    (
        b"\xD4\xC3\xB2\xA1",
        "a capture of network packets: extract the MAVLink frames as a .tlog first",
    ),
    (b"\x7FELF", "a program"),
    (b"#ROSBAG", "a bag of ROS 1: export its topics as a table (.csv)"),
    (
        b"SQLite format 3\0",
        "a database, as of a ROS 2 bag (.db3): export its topics as a table (.csv)",
    ),
    (b"\x89HDF", "an HDF5 file: export it as a table (.csv)"),
    (b"MATLAB ", "a MATLAB file: export it as a table (.csv)"),
    (b"PAR1", "a Parquet file: export it as a table (.csv)"),
    (
        b"H Product:Blackbox",
        "a blackbox log of Betaflight or INAV: export it as a table (.csv) with its decoder",
    ),
    (b"%PDF", "a PDF"),
    (b"\x89PNG", "a picture"),
    (b"version https://git-lfs", "a pointer of Git LFS in place of the file: fetch the file first"),
];

/// First characters of a text, and what it is.
const TEXTS: [(&str, &str); 11] = [
    (
        "FMT, ",
        "a log of ArduPilot as text, as ground stations write it: give the .bin it was made from",
    ),
    ("<!doctype html", "a web page, perhaps from a failed download: download the file again"),
    ("<html", "a web page, perhaps from a failed download: download the file again"),
    ("<?xml", "an XML file"),
    ("{", "a JSON file"),
    ("[{", "a JSON file"),
    ("#!", "a script"),
    ("QGC WPL", "waypoints of a ground station"),
    ("# Onboard parameters", "parameters of a ground station (for `downwash vehicle init`)"),
    ("# MAV ID", "parameters of a ground station (for `downwash vehicle init`)"),
    ("#NOTE:", "parameters of a ground station (for `downwash vehicle init`)"),
];

/// Identifies a file that starts with `head`, if it is known not to be a log.
pub(super) fn known(head: &[u8], extension: Option<&str>) -> Option<&'static str> {
    if head.is_empty() {
        return Some("an empty file: nothing was written, or the copy failed");
    }
    if head.iter().all(|byte| *byte == 0) {
        return Some(
            "zeros: space that was allocated and never written, or a damaged card; copy the log \
             again",
        );
    }
    if let Some((_, found)) = MAGICS.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Some(found);
    }
    if head.get(257..262) == Some(b"ustar") {
        return Some("an archive (tar): unpack it first");
    }
    match extension {
        // Before PX4 1.16 the key was in a separate file and the log had no magic bytes.
        Some("ulge") if !head.starts_with(&super::ulog::MAGIC) => Some(MAGICS[0].1),
        Some("ulgk") => Some("the key of an encrypted log of PX4, not the log"),
        _ => None,
    }
}

/// Identifies a text, if it is known not to be a table.
pub(super) fn known_text(text: &str) -> Option<&'static str> {
    let text = text.trim_start_matches(['\u{feff}', ' ', '\t', '\r', '\n']);
    let begins = |start: &str| {
        text.get(..start.len()).is_some_and(|begin| begin.eq_ignore_ascii_case(start))
    };
    if is_dataflash_text(text) {
        return Some(TEXTS[0].1);
    }
    TEXTS.iter().find(|(start, _)| begins(start)).map(|(_, found)| *found)
}

/// Whether lines begin with the names of ArduPilot's messages: old ground stations wrote other
/// lines before the first.
fn is_dataflash_text(text: &str) -> bool {
    const MESSAGES: [&str; 9] = ["FMT", "PARM", "MSG", "ATT", "IMU", "GPS", "CTUN", "NTUN", "RCOU"];
    const LINES: usize = 100;
    let is_message =
        |line: &&str| line.split_once(',').is_some_and(|(name, _)| MESSAGES.contains(&name.trim()));
    text.lines().take(LINES).filter(is_message).count() > 1
}

/// Description of a DataFlash file of which no message can be read.
pub(super) const NO_DEFINITIONS: &str = "a log of ArduPilot (DataFlash) without the definitions (FMT) of its messages, which are at \
     its start: the start is lost; copy or download the log from the vehicle again";

/// Description of a DataFlash file that is not ArduPilot's.
pub(super) const SDLOG2: &str = "a log of PX4 before ULog (sdlog2, until 2016): PX4 1.4 and later \
                                 write ULog (.ulg), which downwash reads";
