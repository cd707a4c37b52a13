//! Converts rows of a table to samples, with a mapping bound to its columns.

use std::f64::consts::TAU;

use vehicle::frame::{Attitude, Euler, Frd, Ned};

use super::axes::{AttitudeTurn, BodyFrame, WorldFrame, from_matrix, unit};
use super::{Axes, ForceMeaning, QuaternionOrder};

const NO_NUMBER: &str = "row with a cell that is not a finite number";
const NO_ROTATION: &str = "row whose attitude is not a rotation";

const NO_ATTITUDE: &str = "row without the attitude that rotates its vectors";

/// A cell of a row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Cell {
    /// The cell is empty, or has a word for that.
    #[default]
    Empty,
    /// A finite number.
    Number(f64),
    /// Anything else.
    Other,
}

/// A row of the table in SI, NED and FRD. A value is `None` if the table lacks it or its cells are
/// empty.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    pub time: f64,
    pub position: Option<Ned>,
    pub velocity: Option<Ned>,
    pub attitude: Option<Attitude>,
    pub body_rate: Option<Frd>,
    pub specific_force: Option<Frd>,
    pub outputs: Option<[f64; 4]>,
    pub rotor_speed: Option<[f64; 4]>,
    pub voltage: Option<f64>,
    pub setpoint_attitude: Option<Attitude>,
    pub setpoint_rate: Option<Frd>,
    pub setpoint_thrust: Option<f64>,
}

/// Unit of the outputs of a mapped table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outputs {
    /// Fraction of the full thrust.
    Fraction,
    /// Thrust in N.
    Newton,
}

/// Columns of a vector, with their factors to SI units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Columns<const N: usize> {
    pub(super) at: [usize; N],
    pub(super) factors: [f64; N],
}

impl<const N: usize> Columns<N> {
    /// The numbers; `None` if all cells are empty. Any other cell is an error.
    fn read(&self, cells: &[Cell]) -> Result<Option<[f64; N]>, &'static str> {
        let cells = self.at.map(|at| cells.get(at).copied().unwrap_or_default());
        if cells.iter().all(|cell| *cell == Cell::Empty) {
            return Ok(None);
        }
        let mut values = [0.0; N];
        for ((value, cell), factor) in values.iter_mut().zip(cells).zip(self.factors) {
            let Cell::Number(number) = cell else { return Err(NO_NUMBER) };
            *value = number * factor;
        }
        Ok(Some(values))
    }

    /// The numbers; `None` also for invalid cells, which do not invalidate the row.
    fn any(&self, cells: &[Cell]) -> Option<[f64; N]> {
        self.read(cells).ok().flatten()
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Rotation {
    Quaternion(Columns<4>, QuaternionOrder),
    Euler(Columns<3>),
    Matrix(Columns<9>),
}

/// Reads an attitude from a row.
#[derive(Clone, Copy, Debug)]
pub(super) struct AttitudeReader {
    pub(super) rotation: Rotation,
    pub(super) is_inverse: bool,
    pub(super) turn: AttitudeTurn,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct VectorReader {
    pub(super) columns: Columns<3>,
    pub(super) axes: Axes,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct ForceReader {
    pub(super) vector: VectorReader,
    pub(super) meaning: ForceMeaning,
    /// Gravity to take off an acceleration, m/s^2.
    pub(super) gravity_mps2: f64,
}

#[derive(Clone, Debug)]
pub(super) struct MotorReader {
    pub(super) columns: Columns<4>,
    pub(super) range: [f64; 2],
    pub(super) polynomial: Option<Vec<f64>>,
}

/// A mapping bound to the columns of one table.
#[derive(Clone, Debug)]
pub struct RowReader {
    pub(super) world: WorldFrame,
    pub(super) body: BodyFrame,
    pub(super) time: TimeReader,
    pub(super) position: Option<Columns<3>>,
    pub(super) velocity: Option<VectorReader>,
    pub(super) attitude: Option<AttitudeReader>,
    pub(super) body_rate: Option<VectorReader>,
    pub(super) specific_force: Option<ForceReader>,
    pub(super) motors: Option<MotorReader>,
    pub(super) rotor_speed: Option<Columns<4>>,
    pub(super) voltage: Option<Columns<1>>,
    pub(super) setpoint_attitude: Option<AttitudeReader>,
    pub(super) setpoint_rate: Option<VectorReader>,
    pub(super) setpoint_thrust: Option<Columns<1>>,
    pub(super) outputs: Outputs,
    pub(super) used: Vec<bool>,
    pub(super) has_units: bool,
    pub(super) notes: Vec<String>,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum TimeReader {
    Column(Columns<1>),
    /// A column of dates, which count in s.
    Date(Columns<1>),
    Rate(f64),
}

impl RowReader {
    /// Unit of the outputs.
    pub fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// Notes on the columns that the mapping identifies by number.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Whether the line below the names has their units.
    pub fn has_units(&self) -> bool {
        self.has_units
    }

    /// Whether the mapping names a column.
    pub fn uses(&self, column: usize) -> bool {
        self.used.get(column).copied().unwrap_or(false)
    }

    /// Whether a column holds times written as dates.
    pub fn is_date(&self, column: usize) -> bool {
        matches!(self.time, TimeReader::Date(Columns { at: [at], .. }) if at == column)
    }

    /// Time after which the clock of the rows starts again at 0, s: a time of day at midnight, a
    /// counter of ms, us or ns after 32 bits. `None` for other times.
    pub fn clock_period(&self) -> Option<f64> {
        match self.time {
            TimeReader::Date(_) => Some(86_400.0),
            TimeReader::Column(Columns { factors: [unit], .. }) if (0.0..1.0).contains(&unit) => {
                Some(unit * 2f64.powi(32))
            }
            TimeReader::Column(_) | TimeReader::Rate(_) => None,
        }
    }

    /// Whether the roll or the pitch of a row is beyond a full turn. A yaw may count turns.
    pub fn is_beyond_turn(&self, cells: &[Cell]) -> bool {
        let Some(AttitudeReader { rotation: Rotation::Euler(columns), .. }) = self.attitude else {
            return false;
        };
        let angles = columns.any(cells);
        angles.is_some_and(|[roll, pitch, _]| roll.abs().max(pitch.abs()) > TAU)
    }

    /// Converts row number `index` from its cells. The error says why the row is dropped.
    pub fn read(&self, index: u64, cells: &[Cell]) -> Result<Row, &'static str> {
        let time = match self.time {
            TimeReader::Column(column) | TimeReader::Date(column) => {
                column.read(cells)?.ok_or(NO_NUMBER)?[0]
            }
            TimeReader::Rate(rate) => index as f64 / rate,
        };
        let attitude = self.attitude.as_ref().map(|reader| reader.read(cells));
        let attitude = attitude.transpose()?.flatten();
        let vector = |reader: Option<VectorReader>| -> Result<_, &'static str> {
            let Some(VectorReader { columns, axes }) = reader else { return Ok(None) };
            Ok(columns.read(cells)?.map(|vector| (vector, axes)))
        };
        let turn = || attitude.ok_or(NO_ATTITUDE);
        let position = self.position.map(|columns| columns.read(cells)).transpose()?.flatten();
        let velocity = match vector(self.velocity)? {
            Some((v, Axes::World)) => Some(self.world.to_ned(v)),
            Some((v, Axes::Body)) => Some(turn()?.to_world(self.body.to_frd(v))),
            None => None,
        };
        let turning = |reader: Option<VectorReader>| -> Result<_, &'static str> {
            Ok(match vector(reader)? {
                Some((rate, Axes::Body)) => Some(self.body.turning_to_frd(rate)),
                Some((rate, Axes::World)) => Some(turn()?.to_body(self.world.turning_to_ned(rate))),
                None => None,
            })
        };
        let body_rate = turning(self.body_rate)?;
        let specific_force = match self.specific_force {
            Some(ForceReader { vector: reader, meaning, gravity_mps2 }) => {
                match vector(Some(reader))? {
                    Some((force, axes)) => {
                        let force = match axes {
                            Axes::Body => self.body.to_frd(force),
                            Axes::World => turn()?.to_body(self.world.to_ned(force)),
                        };
                        Some(match meaning {
                            ForceMeaning::SpecificForce => force,
                            ForceMeaning::Acceleration => {
                                force - turn()?.to_body(Ned::new(0.0, 0.0, gravity_mps2))
                            }
                        })
                    }
                    None => None,
                }
            }
            None => None,
        };
        let outputs = self.motors.as_ref().map(|reader| reader.read(cells)).transpose()?.flatten();
        let speeds = self.rotor_speed.map(|columns| columns.read(cells)).transpose()?.flatten();
        Ok(Row {
            time,
            position: position.map(|p| self.world.to_ned(p)),
            velocity,
            attitude,
            body_rate,
            specific_force,
            outputs,
            rotor_speed: speeds.map(|speeds| speeds.map(f64::abs)),
            voltage: self.voltage.and_then(|column| column.any(cells)).map(|[v]| v),
            setpoint_attitude: (self.setpoint_attitude)
                .and_then(|reader| reader.read(cells).ok().flatten()),
            setpoint_rate: turning(self.setpoint_rate).ok().flatten(),
            setpoint_thrust: self.setpoint_thrust.and_then(|c| c.any(cells)).map(|[u]| u),
        })
    }
}

impl AttitudeReader {
    fn read(&self, cells: &[Cell]) -> Result<Option<Attitude>, &'static str> {
        let rotation = match self.rotation {
            Rotation::Euler(columns) => columns
                .read(cells)?
                .map(|[roll, pitch, yaw]| Ok(Euler::new(roll, pitch, yaw).attitude())),
            Rotation::Quaternion(columns, order) => columns.read(cells)?.map(|q| {
                let [w, x, y, z] = match order {
                    QuaternionOrder::Wxyz => q,
                    QuaternionOrder::Xyzw => [q[3], q[0], q[1], q[2]],
                };
                unit(Attitude { w, x, y, z }).ok_or(NO_ROTATION)
            }),
            Rotation::Matrix(columns) => {
                columns.read(cells)?.map(|matrix| from_matrix(matrix).ok_or(NO_ROTATION))
            }
        };
        let rotation = rotation.transpose()?;
        let rotation = rotation.map(|r| if self.is_inverse { r.inverse() } else { r });
        Ok(rotation.map(|rotation| self.turn.apply(rotation)))
    }
}

impl MotorReader {
    fn read(&self, cells: &[Cell]) -> Result<Option<[f64; 4]>, &'static str> {
        let [zero, one] = self.range;
        let values = self.columns.read(cells)?;
        let values = values.map(|values| values.map(|value| (value - zero) / (one - zero)));
        Ok(values.map(|values| match &self.polynomial {
            None => values,
            Some(c) => values.map(|x| c.iter().rev().fold(0.0, |sum, c| sum * x + c)),
        }))
    }
}
