//! A hundred passes over 144,000 rows on both networks: full-batch Rprop and Adam on one and two
//! threads, with and without evaluation of the validation rows, and the same full-batch pass with a
//! library's matrix products.
//!
//! `cargo bench --bench training -- [--rows FILE] [--threads N] [--passes 100] [--json]`
//!
//! FILE is the output of `benches/peers/data.py`; without it, the bench draws random rows of the
//! same size.

use std::hint::black_box;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use downwash::learn::samples::Samples;
use downwash::learn::training::{Method, Settings, Training, mean_squared_error, train};
use downwash::model::net::Mlp;

const HIDDEN: usize = 100;
/// Rows for training, validation and test.
const PARTS: [usize; 3] = [144_000, 60_000, 36_000];

struct Options {
    rows: Option<PathBuf>,
    threads: Vec<usize>,
    passes: usize,
    json: bool,
}

fn options() -> Options {
    let mut options = Options { rows: None, threads: vec![1, 2], passes: 100, json: false };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().unwrap_or_else(|| panic!("{arg}: expected a value"));
        match arg.as_str() {
            "--rows" => options.rows = Some(value().into()),
            "--threads" => options.threads = vec![value().parse().expect("a number of threads")],
            "--passes" => options.passes = value().parse().expect("a number of passes"),
            "--json" => options.json = true,
            "--bench" => {} // cargo adds it
            other => panic!("unknown flag {other}"),
        }
    }
    options
}

/// A network's training, validation and test rows.
type Parts = [Samples; 3];

fn samples(
    inputs: usize,
    outputs: usize,
    rows: usize,
    values: impl Iterator<Item = f32>,
) -> Samples {
    let mut samples = Samples::with_capacity(inputs, outputs, rows);
    let mut values = values.fuse();
    for _ in 0..rows {
        let row: Vec<f32> = values.by_ref().take(inputs + outputs).collect();
        samples.push(&row[..inputs], &row[inputs..]).expect("a finite row");
    }
    samples
}

fn read(path: &PathBuf) -> [Parts; 2] {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let (magic, rest) = bytes.split_at(8);
    assert_eq!(magic, b"DWTRAIN1", "{}: expected what data.py wrote", path.display());
    let (head, rest) = rest.split_at(40);
    let word = |at: usize| {
        let bytes = [0, 1, 2, 3].map(|byte| head[4 * at + byte]);
        u32::from_le_bytes(bytes) as usize
    };
    let mut values = rest.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
    [0, 5].map(|first| {
        let (inputs, outputs) = (word(first), word(first + 1));
        [2, 3, 4].map(|part| samples(inputs, outputs, word(first + part), values.by_ref()))
    })
}

/// Rows of uniform random numbers, with products and sines of them as targets.
fn draw() -> [Parts; 2] {
    let mut state = 1_u64;
    let mut uniform = move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        3.4 * ((state >> 40) as f32 / 16_777_216.0 - 0.5)
    };
    [13, 15].map(|inputs| {
        PARTS.map(|rows| {
            let values = std::iter::repeat_with(|| {
                let x: Vec<f32> = (0..inputs).map(|_| uniform()).collect();
                let targets = [0, 1, 2]
                    .map(|i| (0.7 * x[i] * x[i + 6]).sin() + 0.5 * x[i + 3] + 0.07 * uniform());
                x.into_iter().chain(targets)
            });
            samples(inputs, 3, rows, values.flatten())
        })
    })
}

/// CPU seconds and peak memory in MiB of this process.
#[allow(unsafe_code, reason = "the C library alone knows")]
fn usage() -> (f64, f64) {
    // SAFETY: getrusage writes the whole structure, for which zeros are valid.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_SELF, &mut usage);
        usage
    };
    let seconds = |time: libc::timeval| time.tv_sec as f64 + 1e-6 * time.tv_usec as f64;
    (seconds(usage.ru_utime) + seconds(usage.ru_stime), usage.ru_maxrss as f64 / 1024.0)
}

struct Row {
    tool: &'static str,
    threads: usize,
    passes: usize,
    seconds: f64,
    cpu_s: f64,
    networks: Vec<Mlp>,
}

/// Trains both networks in parallel, as `train` does.
fn both(tool: &'static str, nets: &[Parts; 2], threads: usize, settings: &Settings) -> Row {
    let one = |[training, validation, _]: &Parts| -> Training {
        train(training, validation, settings, None, |_, _| ControlFlow::Continue(()))
            .expect("a training")
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let (before, _) = usage();
    let start = Instant::now();
    let (linear, angular) = pool.install(|| rayon::join(|| one(&nets[0]), || one(&nets[1])));
    let seconds = start.elapsed().as_secs_f64();
    let cpu_s = usage().0 - before;
    let networks = vec![linear.network, angular.network];
    Row { tool, threads, passes: settings.passes, seconds, cpu_s, networks }
}

/// The gradients of both networks with `matrixmultiply`, on products over 4,096 rows at a time.
fn gemm(passes: usize) -> Row {
    const ROWS: usize = 4096;
    let (before, _) = usage();
    let start = Instant::now();
    for inputs in [13, 15] {
        let x = vec![0.5_f32; PARTS[0] * inputs];
        let targets = vec![0.1_f32; PARTS[0] * 3];
        let (w, b, v) =
            (vec![0.01_f32; inputs * HIDDEN], vec![0.1; HIDDEN], vec![0.02; HIDDEN * 3]);
        let (mut h, mut e) = (vec![0.0_f32; ROWS * HIDDEN], vec![0.0_f32; ROWS * 3]);
        let mut d = h.clone();
        let (mut dw, mut dv) = (w.clone(), v.clone());
        for _ in 0..passes {
            dw.fill(0.0);
            dv.fill(0.0);
            for (x, targets) in x.chunks(ROWS * inputs).zip(targets.chunks(ROWS * 3)) {
                let rows = x.len() / inputs;
                product([rows, inputs, HIDDEN], x, [inputs, 1], &w, [HIDDEN, 1], 0.0, &mut h);
                for h in h.chunks_mut(HIDDEN) {
                    h.iter_mut().zip(&b).for_each(|(h, b)| *h = (*h + b).max(0.0));
                }
                product([rows, HIDDEN, 3], &h, [HIDDEN, 1], &v, [3, 1], 0.0, &mut e);
                e.iter_mut().zip(targets).for_each(|(e, target)| *e -= target);
                product([HIDDEN, rows, 3], &h, [1, HIDDEN], &e, [3, 1], 1.0, &mut dv);
                product([rows, 3, HIDDEN], &e, [3, 1], &v, [1, 3], 0.0, &mut d);
                for (d, h) in d.iter_mut().zip(&h) {
                    *d = if *h > 0.0 { *d } else { 0.0 };
                }
                product([inputs, rows, HIDDEN], x, [1, inputs], &d, [HIDDEN, 1], 1.0, &mut dw);
            }
            black_box((&dw, &dv));
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    Row { tool: "gemm", threads: 1, passes, seconds, cpu_s: usage().0 - before, networks: vec![] }
}

/// `C = A B + beta C` with the sizes m, k, n; C is row-major.
#[allow(unsafe_code, reason = "the library takes pointers")]
fn product(
    [m, k, n]: [usize; 3],
    a: &[f32],
    a_strides: [usize; 2],
    b: &[f32],
    b_strides: [usize; 2],
    beta: f32,
    c: &mut [f32],
) {
    let last = |rows: usize, columns: usize, strides: [usize; 2]| {
        (rows - 1) * strides[0] + (columns - 1) * strides[1]
    };
    assert!(last(m, k, a_strides) < a.len() && last(k, n, b_strides) < b.len());
    assert!(m * n <= c.len());
    let [[ra, ca], [rb, cb]] = [a_strides, b_strides].map(|strides| strides.map(|s| s as isize));
    let (a, b, c) = (a.as_ptr(), b.as_ptr(), c.as_mut_ptr());
    // SAFETY: the assertions above keep everything that sizes and strides reach within the slices.
    unsafe { matrixmultiply::sgemm(m, k, n, 1.0, a, ra, ca, b, rb, cb, beta, c, n as isize, 1) }
}

fn print(row: &Row, nets: &[Parts; 2], json: bool) {
    let error = |part: usize| -> Vec<f64> {
        let pairs = row.networks.iter().zip(nets);
        pairs.map(|(network, parts)| mean_squared_error(network, &parts[part])).collect()
    };
    let (training, test) = (error(0), error(2));
    let Row { tool, threads, passes, seconds, cpu_s, .. } = row;
    if json {
        let errors: Vec<_> = training
            .iter()
            .zip(&test)
            .map(|(training, test)| serde_json::json!({ "training": training, "test": test }))
            .collect();
        let line = serde_json::json!({
            "tool": tool, "threads": threads, "passes": passes, "seconds": seconds,
            "cpu_s": cpu_s, "peak_mib": usage().1, "errors": errors,
        });
        println!("{line}");
    } else {
        let flops = 200.0 * *passes as f64 * PARTS[0] as f64 * (2 * 28 + 4 * 3 + 6) as f64;
        let list = |errors: &[f64]| errors.iter().map(|e| format!(" {e:.5}")).collect::<String>();
        println!(
            "{tool:26} {threads} threads, {passes} passes: {seconds:.3} s, {cpu_s:.2} CPU s, \
             {:.0} GF/s; training{}; test{}",
            flops / seconds / 1e9,
            list(&training),
            list(&test)
        );
    }
}

fn main() {
    let options = options();
    let nets = options.rows.as_ref().map_or_else(draw, read);
    for &threads in &options.threads {
        let blind = Settings {
            hidden: HIDDEN,
            passes: options.passes,
            method: Method::Rprop,
            validation_interval: options.passes,
            patience: usize::MAX,
            ..Settings::default()
        };
        let looking = Settings { validation_interval: 5, ..blind.clone() };
        let adam = Settings { method: Method::Adam, ..blind.clone() };
        for (tool, settings) in [
            ("downwash rprop", &blind),
            ("downwash rprop, validation", &looking),
            ("downwash adam", &adam),
        ] {
            print(&both(tool, &nets, threads, settings), &nets, options.json);
        }
    }
    if options.threads.contains(&1) {
        print(&gemm(options.passes.div_ceil(10)), &nets, options.json);
    }
}
