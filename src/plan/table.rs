//! A trajectory from the rows of a CSV file.

use std::f64::consts::PI;

use vehicle::frame::{Ned, wrap_angle};

use super::desired_point::DesiredPoint;

/// Rows at increasing times, joined by cubic Hermite splines (position) and straight lines (yaw).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Table {
    /// At least two, times strictly increasing from 0.
    rows: Vec<Row>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Row {
    t: f64,
    position: Ned,
    velocity: Ned,
    yaw: f64,
}

/// The columns of a CSV trajectory; `t_s` and the position are required.
const COLUMNS: [&str; 8] = ["t_s", "n_m", "e_m", "d_m", "yaw_rad", "v_n_mps", "v_e_mps", "v_d_mps"];

/// First index of the velocity in [`COLUMNS`], and the number of columns that every table has.
const VELOCITY: usize = 5;
const REQUIRED: usize = 4;

/// Rows closer to the previous one are dropped, s: a vehicle cannot follow anything shorter, and at
/// positions rounded to a micrometre, closer rows would turn the rounding into accelerations.
const ROW_SPACING_S: f64 = 0.01;

/// Rounding of a written angle, rad.
const WRAPPED_SLACK: f64 = 1e-3;

impl Table {
    /// Parses CSV with a header of the names in [`COLUMNS`], in any order. Without velocity
    /// columns, the velocity is the slope between the neighbouring rows, and zero at both ends.
    /// Rows closer than [`ROW_SPACING_S`] to the previous one are dropped, except the first and the
    /// last. The error text names the line.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let (_, header) = lines.next().ok_or("expected a header line, found an empty file")?;
        let order = columns(header)?;
        let with_velocity = order.contains(&VELOCITY);
        let mut rows: Vec<Row> = Vec::new();
        for (index, line) in lines {
            let line_error = |reason: String| format!("line {}: {reason}", index + 1);
            let [t, n, e, d, yaw, vn, ve, vd] = cells(line, &order).map_err(line_error)?;
            if rows.last().is_some_and(|last| t <= last.t) {
                let reason =
                    format!("t_s: expected a later time than on the line before, found {t}");
                return Err(line_error(reason));
            }
            let (position, velocity) = (Ned::new(n, e, d), Ned::new(vn, ve, vd));
            rows.push(Row { t, position, velocity, yaw });
        }
        let start = match rows.as_slice() {
            [first, _, ..] => first.t,
            _ => return Err(format!("expected at least two rows, found {}", rows.len())),
        };
        rows.iter_mut().for_each(|row| row.t -= start);
        unwrap_yaw(&mut rows);
        let mut rows = spaced(rows);
        if !with_velocity {
            derive_velocity(&mut rows);
        }
        Ok(Self { rows })
    }

    /// Length in s.
    pub fn duration(&self) -> f64 {
        self.rows.last().map_or(0.0, |row| row.t)
    }

    /// The point at `t` within the duration.
    pub fn sample(&self, t: f64) -> DesiredPoint {
        let next = self.rows.partition_point(|row| row.t <= t).clamp(1, self.rows.len() - 1);
        let (a, b) = (&self.rows[next - 1], &self.rows[next]);
        let length = b.t - a.t;
        let x = (t - a.t) / length;
        let (x2, x3) = (x * x, x * x * x);
        let chord = b.position - a.position;
        let tangent_a = a.velocity * length;
        let tangent_b = b.velocity * length;
        let yaw_step = b.yaw - a.yaw;
        DesiredPoint {
            position: a.position
                + chord * (3.0 * x2 - 2.0 * x3)
                + tangent_a * (x3 - 2.0 * x2 + x)
                + tangent_b * (x3 - x2),
            velocity: (chord * (6.0 * x - 6.0 * x2)
                + tangent_a * (3.0 * x2 - 4.0 * x + 1.0)
                + tangent_b * (3.0 * x2 - 2.0 * x))
                * (1.0 / length),
            acceleration: (chord * (6.0 - 12.0 * x)
                + tangent_a * (6.0 * x - 4.0)
                + tangent_b * (6.0 * x - 2.0))
                * (1.0 / (length * length)),
            yaw: a.yaw + yaw_step * x,
            yaw_rate: yaw_step / length,
        }
    }
}

/// The rows without those too close to the previous one. The first and the last stay.
fn spaced(rows: Vec<Row>) -> Vec<Row> {
    // Tolerance for times that were written to a microsecond.
    let least = ROW_SPACING_S - 1e-6;
    let mut kept: Vec<Row> = Vec::new();
    let last = rows.last().copied();
    for row in rows {
        if kept.last().is_none_or(|before| row.t - before.t >= least) {
            kept.push(row);
        }
    }
    if let Some(last) = last.filter(|last| kept.last().is_some_and(|kept| kept.t < last.t)) {
        if kept.len() > 1 {
            kept.pop();
        }
        kept.push(last);
    }
    kept
}

/// The column of each field, from the header.
fn columns(header: &str) -> Result<Vec<usize>, String> {
    let mut order = Vec::new();
    for name in header.split(',').map(str::trim) {
        let column = COLUMNS.iter().position(|known| *known == name).ok_or_else(|| {
            format!("unknown column {name:?}: expected one of {}", COLUMNS.join(", "))
        })?;
        if order.contains(&column) {
            return Err(format!("column {name} appears twice: expected it once"));
        }
        order.push(column);
    }
    let has = |column: usize| order.contains(&column);
    if let Some(missing) = (0..REQUIRED).find(|column| !has(*column)) {
        return Err(format!("column {} is missing", COLUMNS[missing]));
    }
    let with_velocity = has(VELOCITY);
    if let Some(odd) = (VELOCITY..COLUMNS.len()).find(|column| has(*column) != with_velocity) {
        let [there, missing] = if with_velocity { [VELOCITY, odd] } else { [odd, VELOCITY] };
        return Err(format!(
            "column {} is present, but {} is missing: expected all three of the velocity, or none",
            COLUMNS[there], COLUMNS[missing]
        ));
    }
    Ok(order)
}

/// The values of a line in the order of [`COLUMNS`]; 0 in columns that the table lacks.
fn cells(line: &str, order: &[usize]) -> Result<[f64; COLUMNS.len()], String> {
    let mut cells = [0.0; COLUMNS.len()];
    let mut fields = line.split(',');
    for column in order {
        let field = fields.next().unwrap_or("").trim();
        let value = field.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| {
            format!("{}: expected a finite number, found {field:?}", COLUMNS[*column])
        })?;
        cells[*column] = value;
    }
    if fields.next().is_some() {
        return Err(format!("expected {} fields, found more", order.len()));
    }
    Ok(cells)
}

/// Sets each velocity to the slope between the neighbouring rows; both ends keep theirs.
fn derive_velocity(rows: &mut [Row]) {
    let slopes: Vec<Ned> = rows
        .windows(3)
        .map(|w| (w[2].position - w[0].position) * (1.0 / (w[2].t - w[0].t)))
        .collect();
    for (row, slope) in rows.iter_mut().skip(1).zip(slopes) {
        row.velocity = slope;
    }
}

/// Unwraps a yaw that was written within half a turn of north, where it jumps from one side to the
/// other. A yaw written beyond that range is already continuous, and may turn by any angle per row.
fn unwrap_yaw(rows: &mut [Row]) {
    if rows.iter().any(|row| row.yaw.abs() > PI + WRAPPED_SLACK) {
        return;
    }
    let mut before = rows.first().map_or(0.0, |row| row.yaw);
    for row in rows {
        row.yaw = before + wrap_angle(row.yaw - before);
        before = row.yaw;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_passes_rows_and_joins_them_smoothly() {
        let text = "t_s,n_m,e_m,d_m,yaw_rad\n1,0,0,-1,0\n2,1,0,-1,1\n4,1,2,-1,1\n";
        let table = Table::parse(text).expect("a table");
        assert_eq!(table.duration(), 3.0);
        assert!((table.sample(1.0).position - Ned::new(1.0, 0.0, -1.0)).norm() < 1e-12);
        let h = 1e-6;
        let slope = (table.sample(1.0).position - table.sample(1.0 - h).position) * (1.0 / h);
        assert!((slope - table.sample(1.0).velocity).norm() < 1e-4);
        assert_eq!(table.sample(0.5).yaw_rate, 1.0);
    }

    #[test]
    fn dense_rows_are_thinned_without_rounding_accelerations() {
        let path = |t: f64| (0.5 * t).sin();
        let rows = (0..=100_000).map(|n| f64::from(n) * 2e-4);
        let rows = rows.map(|t| format!("{t:.6},{:.6},0,-1\n", path(t)));
        let text = format!("t_s,n_m,e_m,d_m\n{}", rows.collect::<String>());
        let table = Table::parse(&text).expect("a table");
        assert!(table.rows.len() <= 2001, "{} rows", table.rows.len());
        assert_eq!(table.duration(), 20.0);
        assert!((table.sample(20.0).position.north() - path(20.0)).abs() < 1e-6);
        for n in 10..1900 {
            let point = table.sample(f64::from(n) * 0.01 + 0.003);
            assert!((point.acceleration.north() + 0.25 * point.position.north()).abs() < 0.1);
        }
    }

    #[test]
    fn two_close_rows_are_both_kept() {
        let table = Table::parse("t_s,n_m,e_m,d_m\n0,0,0,-1\n0.001,0,0,-1\n").expect("a table");
        assert_eq!(table.duration(), 0.001);
    }

    #[test]
    fn yaw_continues_through_half_a_turn() {
        let yaw_rates = |yaws: [f64; 3]| {
            let rows = yaws.iter().zip(0..).map(|(yaw, t)| format!("{t},0,0,-1,{yaw}\n"));
            let text = format!("t_s,n_m,e_m,d_m,yaw_rad\n{}", rows.collect::<String>());
            let table = Table::parse(&text).expect("a table");
            [0.5, 1.5].map(|t| table.sample(t).yaw_rate)
        };
        for rate in yaw_rates([3.0, -3.0, -2.7]) {
            assert!((rate - 0.29).abs() < 0.02, "{rate}");
        }
        // A continuous yaw may turn by any angle.
        assert_eq!(yaw_rates([0.0, 4.0, 8.0]), [4.0; 2]);
    }

    #[test]
    fn duplicate_columns_and_partial_velocities_are_refused_by_name() {
        let error = |text| Table::parse(text).expect_err("refused");
        assert!(error("t_s,n_m,e_m,d_m,n_m\n").contains("n_m appears twice"));
        let missing = error("t_s,n_m,e_m,d_m,v_n_mps,v_d_mps\n");
        assert!(missing.contains("v_n_mps is present, but v_e_mps is missing"), "{missing}");
        assert!(error("t_s,n_m,e_m,d_m,v_d_mps\n").contains("v_n_mps is missing"));
    }

    #[test]
    fn invalid_rows_are_refused_by_line() {
        let error = |text| Table::parse(text).expect_err("refused");
        assert!(error("").contains("header"));
        assert!(error("t_s,n_m,e_m\n").contains("d_m is missing"));
        assert!(error("t_s,n_m,e_m,d_m,up\n").contains("\"up\""));
        assert!(error("t_s,n_m,e_m,d_m\n0,0,0,0\n").contains("two rows"));
        assert!(error("t_s,n_m,e_m,d_m\n0,0,0,0\n0,0,0,0\n").contains("line 3"));
        assert!(error("t_s,n_m,e_m,d_m\n0,0,0,NaN\n").contains("line 2: d_m"));
        assert!(error("t_s,n_m,e_m,d_m\n0,0,0,0,9\n").contains("more"));
    }
}
