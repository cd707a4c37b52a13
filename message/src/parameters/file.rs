//! Parameter files of QGroundControl (.params), Mission Planner (.param), MAVProxy (.parm) and
//! PX4's `param save` (BSON).

mod bson;

use std::borrow::Cow;
use std::collections::BTreeMap;

use encoding_rs::Encoding;

use super::Parameters;

/// Length limit of a parameter's name.
const NAME_MAX: usize = 16;
/// MAV_COMP_ID_AUTOPILOT1: the component of PX4 and ArduPilot.
const AUTOPILOT: u8 = 1;
/// Remarks of one kind that are listed; the rest are counted.
const REMARKS_LISTED: usize = 5;

/// The file is not a parameter file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "no parameters: expected lines of NAME and value, as QGroundControl, Mission Planner and \
     MAVProxy write them, or what PX4's `param save` writes; {0}"
)]
pub struct NotParameters(String);

/// The file does not single out the autopilot of one vehicle.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotOneVehicle {
    /// It holds several vehicles, which state their ids.
    #[error(
        "expected the parameters of one vehicle, found those of {0}; choose one with --system, or \
         export the parameters of one vehicle"
    )]
    Several(String),
    /// It holds two vehicles that nothing tells apart.
    #[error(
        "expected the parameters of one vehicle, found most of them twice with different values, \
         such as {0}; export the parameters of one vehicle"
    )]
    Twice(String),
    /// It does not hold the chosen vehicle.
    #[error(
        "expected the parameters of system {system} (--system), found those of {found}; give one of \
         these, or leave --system out"
    )]
    NoSystem {
        /// The requested system id.
        system: u8,
        /// The ids in the file.
        found: String,
    },
    /// It holds several components of the vehicle, and none is the autopilot's.
    #[error(
        "expected the parameters of an autopilot, component {AUTOPILOT}, found those of {0}; export the \
         autopilot's parameters"
    )]
    NoAutopilot(String),
}

/// Ids of a row in QGroundControl's format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Ids {
    system: u8,
    component: u8,
}

/// The parameters of one sender.
#[derive(Clone, Debug, Default, PartialEq)]
struct Set {
    values: Parameters,
    /// Places of the values, such as `line 7`.
    places: BTreeMap<String, String>,
    /// Parameters whose values are no finite numbers, in words.
    unreadable: Vec<String>,
    /// Parameters that are repeated with another value, in words.
    differing: Vec<String>,
    /// Number of repeated parameters.
    repeated: usize,
}

impl Set {
    fn add(&mut self, place: String, name: String, value: &str) {
        let Some(number) = number(value) else {
            let value: String = value.chars().take(20).collect();
            self.unreadable.push(format!(
                "{place}: {name}: expected a number, found {value:?}; the parameter is left out"
            ));
            return;
        };
        if let Some(before) = self.places.get(&name) {
            self.repeated += 1;
            let known = self.values.get(&name).copied().unwrap_or(f64::NAN);
            if known != number {
                self.differing
                    .push(format!("{name}, which is {known} on {before} and {number} on {place}"));
            }
        }
        self.places.insert(name.clone(), place);
        self.values.set(name, number);
    }

    /// Whether the set looks like those of two vehicles, one after the other. A later correction
    /// repeats few parameters.
    fn is_two(&self) -> bool {
        !self.differing.is_empty() && 2 * self.repeated > self.values.len()
    }

    fn remarks(&self) -> Vec<String> {
        let repeated =
            self.differing.iter().map(|which| format!("{which}; the last value is used"));
        let repeated: Vec<String> = repeated.collect();
        let mut remarks = Vec::new();
        for (kind, what) in [
            (&self.unreadable, "parameters without a readable value"),
            (&repeated, "parameters with two values"),
        ] {
            remarks.extend(kind.iter().take(REMARKS_LISTED).cloned());
            let more = kind.len().saturating_sub(REMARKS_LISTED);
            if more > 0 {
                remarks.push(format!("and {more} more {what}"));
            }
        }
        remarks
    }
}

/// The autopilot's parameters of one vehicle in a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OneVehicle {
    /// The parameters that have a readable value.
    pub parameters: Parameters,
    /// What was left out of the file or repeated in it, in words.
    pub remarks: Vec<String>,
}

/// The content of a parameter file: the parameters of one vehicle or of several.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParameterFile {
    /// By sender; only QGroundControl's format states the ids.
    sets: BTreeMap<Option<Ids>, Set>,
}

impl ParameterFile {
    /// Parses a parameter file in any of the formats. A parameter without a readable value is left
    /// out, with a remark.
    ///
    /// # Errors
    /// [`NotParameters`] if a line or element fits no format, or the file has no parameters.
    pub fn parse(bytes: &[u8]) -> Result<Self, NotParameters> {
        let mut file = Self::default();
        // Windows shells redirect output as UTF-16, with a byte order mark.
        if let Some((encoding, _)) = Encoding::for_bom(bytes) {
            file.read_lines(&encoding.decode(bytes).0)?;
        } else if bson::is_document(bytes) {
            let set = bson::read(bytes)
                .ok_or_else(|| NotParameters("its BSON document is damaged".to_owned()))?;
            file.sets.insert(None, set);
        } else if bytes.contains(&0) {
            return Err(NotParameters("it is neither text nor BSON".to_owned()));
        } else {
            file.read_lines(&String::from_utf8_lossy(bytes))?;
        }
        if file.sets.values().all(|set| set.values.is_empty()) {
            let unreadable = file.sets.values().find_map(|set| set.unreadable.first());
            return Err(NotParameters(unreadable.map_or("it has none".to_owned(), |first| {
                format!("none of its values is a number: {first}")
            })));
        }
        Ok(file)
    }

    fn read_lines(&mut self, text: &str) -> Result<(), NotParameters> {
        for (at, line) in text.lines().enumerate() {
            let content = without_comment(line).trim();
            if content.is_empty() {
                continue;
            }
            let Some((ids, name, value)) = row(content) else {
                let line: String = content.chars().take(60).collect();
                return Err(NotParameters(format!("line {} is {line:?}", at + 1)));
            };
            self.sets.entry(ids).or_default().add(format!("line {}", at + 1), name, value);
        }
        Ok(())
    }

    /// The parameters of the autopilot of `system`, or of the only vehicle in the file.
    ///
    /// # Errors
    /// [`NotOneVehicle`].
    pub fn vehicle(&self, system: Option<u8>) -> Result<OneVehicle, NotOneVehicle> {
        let ids: Vec<Option<Ids>> = self.sets.keys().copied().collect();
        let of = |ids: &Option<Ids>| ids.map(|ids| ids.system);
        let mut systems: Vec<Option<u8>> = ids.iter().map(of).collect();
        systems.dedup();
        let chosen = match (system, systems.as_slice()) {
            (Some(system), systems) if systems.contains(&Some(system)) => Some(system),
            (Some(system), _) => {
                return Err(NotOneVehicle::NoSystem { system, found: ids_text(&ids) });
            }
            (None, [only]) => *only,
            (None, _) => return Err(NotOneVehicle::Several(ids_text(&ids))),
        };
        let of_vehicle: Vec<Option<Ids>> =
            ids.into_iter().filter(|ids| of(ids) == chosen).collect();
        let is_autopilot = |ids: &&Option<Ids>| ids.is_some_and(|ids| ids.component == AUTOPILOT);
        let autopilot = match of_vehicle.as_slice() {
            [only] => only,
            several => several
                .iter()
                .find(is_autopilot)
                .ok_or_else(|| NotOneVehicle::NoAutopilot(ids_text(several)))?,
        };
        let set = self.sets.get(autopilot).cloned().unwrap_or_default();
        if let (true, Some(first)) = (set.is_two(), set.differing.first()) {
            return Err(NotOneVehicle::Twice(first.clone()));
        }
        let mut remarks = set.remarks();
        let others: Vec<Option<Ids>> =
            of_vehicle.iter().filter(|ids| *ids != autopilot).copied().collect();
        if !others.is_empty() {
            remarks.push(format!(
                "the parameters of {} are left out; the autopilot is component {AUTOPILOT}",
                ids_text(&others)
            ));
        }
        Ok(OneVehicle { parameters: set.values, remarks })
    }
}

/// Senders as words, such as `system 1 (components 1, 100) and system 2 (component 1)`.
fn ids_text(senders: &[Option<Ids>]) -> String {
    let mut systems: BTreeMap<Option<u8>, Vec<String>> = BTreeMap::new();
    for ids in senders {
        let components = systems.entry(ids.map(|ids| ids.system)).or_default();
        components.extend(ids.map(|ids| ids.component.to_string()));
    }
    let word = |(system, components): (&Option<u8>, &Vec<String>)| match system {
        None => "no stated system".to_owned(),
        Some(system) => {
            let plural = if components.len() > 1 { "s" } else { "" };
            format!("system {system} (component{plural} {})", components.join(", "))
        }
    };
    systems.iter().map(word).collect::<Vec<_>>().join(" and ")
}

/// The line up to its comment. A `#` inside a value, as in `1.#QNAN`, begins none.
fn without_comment(line: &str) -> &str {
    let begins = |at: &usize| {
        let before = line.get(..*at).and_then(|before| before.chars().next_back());
        before.is_none_or(|c| c.is_whitespace() || c == ',')
    };
    let comment = line.match_indices('#').map(|(at, _)| at).find(begins);
    comment.and_then(|at| line.get(..at)).unwrap_or(line)
}

/// Sender, name and text of the value in a line.
fn row(line: &str) -> Option<(Option<Ids>, String, &str)> {
    let is_separator = |c: char| c == ',' || c == '=' || c.is_whitespace();
    // Where something else separates the fields, a comma is a decimal mark.
    let has_commas = line.chars().find(|c| is_separator(*c)) == Some(',');
    let fields: Vec<&str> = line
        .split(|c: char| is_separator(c) && (has_commas || c != ','))
        .map(|field| field.trim_matches(','))
        .filter(|field| !field.is_empty())
        .collect();
    // QGroundControl: system, component, name, value, type.
    if let [system, component, name, rest @ ..] = fields.as_slice()
        && let (Ok(system), Ok(component)) = (system.parse(), component.parse())
        && rest.len() <= 2
    {
        // Tabs keep the place of an empty value.
        let value = match line.split('\t').nth(3) {
            Some(value) => value.trim(),
            None => rest.first().copied().unwrap_or_default(),
        };
        return pair(name, value)
            .map(|(name, value)| (Some(Ids { system, component }), name, value));
    }
    let (name, value) = match fields.as_slice() {
        // The third column may be a flag such as @READONLY.
        [name, value] | [name, value, _] => pair(name, value)?,
        [name] => pair(name, "")?,
        _ => return None,
    };
    Some((None, name, value))
}

/// A name with the text of its value. Only names as autopilots spell them may lack a readable
/// value: other lines are none of a parameter file.
fn pair<'a>(name: &str, value: &'a str) -> Option<(String, &'a str)> {
    let is_usual = !name.bytes().any(|byte| byte.is_ascii_lowercase());
    let name = name_of(name)?;
    (is_usual || number(value).is_some()).then_some((name, value))
}

/// A finite number, with a point or a comma as its decimal mark.
fn number(text: &str) -> Option<f64> {
    let is_comma = text.matches(',').count() == 1 && !text.contains('.');
    let text = if is_comma { Cow::Owned(text.replace(',', ".")) } else { Cow::Borrowed(text) };
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

fn name_of(name: &str) -> Option<String> {
    let is_name = !name.is_empty()
        && name.len() <= NAME_MAX
        && name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    is_name.then(|| name.to_owned())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn only(bytes: &[u8]) -> OneVehicle {
        ParameterFile::parse(bytes).expect("parameters").vehicle(None).expect("one vehicle")
    }

    fn listed(parameters: &Parameters) -> Vec<(String, f64)> {
        parameters.iter().map(|(n, v)| (n.clone(), *v)).collect()
    }

    fn pairs(bytes: &[u8]) -> Vec<(String, f64)> {
        listed(&only(bytes).parameters)
    }

    fn refusal(bytes: &[u8], system: Option<u8>) -> String {
        let file = ParameterFile::parse(bytes).expect("parameters");
        file.vehicle(system).expect_err("not one vehicle").to_string()
    }

    #[test]
    fn utf16_file_is_read_as_its_text() {
        let text = "MC_ROLL_P 6.5\r\nSYS_AUTOSTART 4001\r\n";
        let little = [0xfffe_u16.swap_bytes()].into_iter().chain(text.encode_utf16());
        let little: Vec<u8> = little.flat_map(u16::to_le_bytes).collect();
        let big = [0xfeff_u16].into_iter().chain(text.encode_utf16());
        let big: Vec<u8> = big.flat_map(u16::to_be_bytes).collect();
        for bytes in [little, big] {
            assert_eq!(pairs(&bytes), expected());
        }
    }

    fn expected() -> [(String, f64); 2] {
        [("MC_ROLL_P".to_owned(), 6.5), ("SYS_AUTOSTART".to_owned(), 4001.0)]
    }

    #[test]
    fn every_ground_station_format_is_parsed() {
        let ground_control = "# Onboard parameters for Vehicle 1\n#\n\
            1\t1\tMC_ROLL_P\t6.500000000000000000\t9\n1\t1\tSYS_AUTOSTART\t4001\t6\n";
        let planner = "#NOTE: 1/2/2026\nMC_ROLL_P,6.5\r\nSYS_AUTOSTART,4001\r\n";
        let proxy = "MC_ROLL_P        6.500000\nSYS_AUTOSTART    4001 # start\n";
        let spaced = "MC_ROLL_P , 6.5\nSYS_AUTOSTART = 4001\n";
        let decimal_comma = "1\t1\tMC_ROLL_P\t6,5\t9\n1\t1\tSYS_AUTOSTART\t4001\t6\n";
        for text in [ground_control, planner, proxy, spaced, decimal_comma] {
            assert_eq!(pairs(text.as_bytes()), expected(), "{text}");
            assert_eq!(only(text.as_bytes()).remarks, Vec::<String>::new(), "{text}");
        }
        // A comment may be in an encoding of before Unicode.
        let old = b"# Flugger\xE4t\nMC_ROLL_P,6.5\nSYS_AUTOSTART,4001\n";
        assert_eq!(pairs(old), expected());
    }

    #[test]
    fn px4_bson_document_is_parsed() {
        let document = |roll: f64| {
            let mut document = vec![0; 4];
            document.extend(b"\x10SYS_AUTOSTART\0");
            document.extend(4001i32.to_le_bytes());
            document.extend(b"\x01MC_ROLL_P\0");
            document.extend(roll.to_le_bytes());
            document.push(0);
            let length = (document.len() as u32).to_le_bytes();
            document[..4].copy_from_slice(&length);
            document
        };
        assert_eq!(pairs(&document(6.5)), expected());
        assert!(ParameterFile::parse(&document(6.5)[..20]).is_err());
        let OneVehicle { parameters, remarks } = only(&document(f64::NAN));
        assert_eq!((parameters.len(), remarks.len()), (1, 1));
        assert!(remarks[0].starts_with("element 2: MC_ROLL_P"), "{remarks:?}");
    }

    #[test]
    fn several_vehicles_are_named_and_one_can_be_chosen() {
        let text = b"1\t1\tMC_ROLL_P\t6.5\t9\n1\t1\tSYS_AUTOSTART\t4001\t6\n\
            2\t1\tMC_ROLL_P\t8\t9\n2\t100\tCAM_MODE\t1\t6\n";
        let several = refusal(text, None);
        for said in ["system 1 (component 1)", "system 2 (components 1, 100)", "--system"] {
            assert!(several.contains(said), "{said}: {several}");
        }
        let file = ParameterFile::parse(text).expect("parameters");
        let chosen = |system| file.vehicle(Some(system)).expect("one vehicle");
        assert_eq!(chosen(1).parameters.number("MC_ROLL_P"), Some(6.5));
        assert_eq!(chosen(1).remarks, Vec::<String>::new());
        assert_eq!(chosen(2).parameters.number("MC_ROLL_P"), Some(8.0));
        let other = refusal(text, Some(3));
        assert!(other.contains("system 3") && other.contains("system 2"), "{other}");
        let without = refusal(b"MC_ROLL_P 6.5\n", Some(1));
        assert!(without.contains("no stated system"), "{without}");
    }

    #[test]
    fn parameters_of_other_components_are_left_out_and_named_once() {
        let OneVehicle { parameters, remarks } = only(
            b"1\t1\tMC_ROLL_P\t6.5\t9\n1\t100\tCAM_MODE\t1\t6\n1\t100\tCAM_ISO\tnan\t9\n\
            1\t154\tMC_ROLL_P\t2\t9\n1\t1\tSYS_AUTOSTART\t4001\t6\n",
        );
        assert_eq!(listed(&parameters), expected());
        assert_eq!(remarks.len(), 1, "{remarks:?}");
        assert!(remarks[0].contains("components 100, 154"), "{remarks:?}");
        // An autopilot may have another id, if nothing else is there.
        assert_eq!(pairs(b"1\t2\tMC_ROLL_P\t6.5\t9\n").len(), 1);
        let neither = refusal(b"1\t100\tCAM_MODE\t1\t6\n1\t154\tMNT_MODE\t2\t9\n", None);
        assert!(neither.contains("components 100, 154"), "{neither}");
    }

    #[test]
    fn files_of_two_vehicles_one_after_the_other_are_refused() {
        let twice =
            refusal(b"MC_ROLL_P,6.5\nSYS_AUTOSTART,4001\nMC_ROLL_P,8\nSYS_AUTOSTART,4001\n", None);
        assert!(twice.contains("MC_ROLL_P") && twice.contains("line 1"), "{twice}");
        // A correction at the end stays one, and is said.
        let corrected = only(b"MC_ROLL_P 8\nSYS_AUTOSTART 4001\nCA_AIRFRAME 0\nMC_ROLL_P 6.5\n");
        assert_eq!(corrected.parameters.number("MC_ROLL_P"), Some(6.5));
        assert!(corrected.remarks[0].contains("8 on line 1 and 6.5 on line 4"));
    }

    #[test]
    fn unreadable_value_costs_only_its_parameter() {
        for value in ["nan", "-NaN", "inf", "1e999", "1.#QNAN", "--", "0x1F", "1,2,3"] {
            for line in [
                format!("1\t1\tMC_PITCH_P\t{value}\t9"),
                format!("MC_PITCH_P {value}"),
                format!("MC_PITCH_P={value}"),
            ] {
                let ids = if line.starts_with('1') { "1\t1\t" } else { "" };
                let text = format!("{ids}MC_ROLL_P\t6.5\n{line}\n{ids}SYS_AUTOSTART\t4001\n");
                let OneVehicle { parameters, remarks } = only(text.as_bytes());
                assert_eq!(listed(&parameters), expected(), "{text}");
                let said = format!("line 2: MC_PITCH_P: expected a number, found {value:?}");
                assert!(remarks.len() == 1 && remarks[0].starts_with(&said), "{text}{remarks:?}");
            }
        }
        for line in ["MC_PITCH_P", "MC_PITCH_P,", "1\t1\tMC_PITCH_P\t\t9", "1\t1\tMC_PITCH_P"] {
            let ids = if line.starts_with('1') { "1\t1\t" } else { "" };
            let text = format!("{ids}MC_ROLL_P\t6.5\n{line}\n{ids}SYS_AUTOSTART\t4001\n");
            assert_eq!(pairs(text.as_bytes()), expected(), "{text}");
        }
        // Many are counted.
        let many: String = (0..20).map(|at| format!("RC{at}_TRIM nan\n")).collect();
        let remarks = only(format!("MC_ROLL_P 6.5\n{many}").as_bytes()).remarks;
        assert!(remarks.len() == 6 && remarks[5].contains("15 more"), "{remarks:?}");
        let error = ParameterFile::parse(many.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("line 1: RC0_TRIM"), "{error}");
    }

    #[test]
    fn file_without_parameters_is_refused_with_its_line() {
        let error = ParameterFile::parse(b"# a\nname = \"crazyflie\"\n").unwrap_err().to_string();
        assert!(error.contains("line 2"), "{error}");
        let error = ParameterFile::parse(b"").unwrap_err().to_string();
        assert!(error.contains("it has none"), "{error}");
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic_the_parser(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            if let Ok(file) = ParameterFile::parse(&bytes) {
                let _ = file.vehicle(None);
            }
        }
    }
}
