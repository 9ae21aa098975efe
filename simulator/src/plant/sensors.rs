//! Inputs of the board: drum encoders, tension sensors, drive feedback, e-stop.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::bus::Feedback;
use super::faults::{CableFaults, EncoderFault, TensionFault};
use super::params::{MAX_CABLES, TensionSensorParams, WinchParams};

/// Full scale of the tension converter: 16 conversions of 12 bits, summed.
pub(crate) const ADC_FULL_SCALE: u16 = 65_520;
/// Reference voltage (V), equivalent to [`ADC_STEPS_PER_REFERENCE`].
pub(crate) const ADC_REFERENCE_V: f64 = 3.3;
/// Steps of the reference voltage: 16 conversions of 4096 steps; the last step is never reached.
pub(crate) const ADC_STEPS_PER_REFERENCE: f64 = 65_536.0;

/// Greatest count rate of a floating pair of inputs, Hz: beside motor cables that switch at 20 kHz,
/// both edges of both lines.
const FLOATING_HZ: f64 = 80e3;

/// One reading of all inputs. Entries beyond the robot's cables are 0 or `None`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensors {
    /// Drum encoder counters, wrapping, as a 16-bit timer in encoder mode shows them.
    pub encoder_counts: [u16; MAX_CABLES],
    /// Tension converters: 0..=65520 for 0 V to 3.3 V.
    pub adc: [u16; MAX_CABLES],
    /// The latest feedback of each drive that has arrived over the bus.
    pub feedback: [Option<Feedback>; MAX_CABLES],
    /// `true` while the e-stop is pressed.
    pub e_stop: bool,
}

/// Sensor state of one cable.
#[derive(Debug, Clone)]
pub(crate) struct CableSensors {
    counts_per_metre: f64,
    /// Position of the drum between two counts when the counter started, 0 to 1.
    phase: f64,
    /// Counts added by slips, glitches that stay, and presets.
    shift: i64,
    sensor: TensionSensorParams,
    held_counts: Option<(EncoderFault, i64)>,
    held_adc: Option<u16>,
    /// Voltage at the pin, and when it was read last.
    pin_v: f64,
    read_s: f64,
    /// Noise of the last reading that drew some, standard normal.
    noise: f64,
    drift_n: f64,
    drift_since_s: Option<f64>,
}

impl CableSensors {
    pub(crate) fn new(p: &WinchParams, phase: f64) -> Self {
        Self {
            counts_per_metre: f64::from(p.encoder_sign) / p.metres_per_encoder_count(),
            phase,
            shift: 0,
            sensor: p.sensor.clone(),
            held_counts: None,
            held_adc: None,
            pin_v: 0.0,
            read_s: 0.0,
            noise: 0.0,
            drift_n: 0.0,
            drift_since_s: None,
        }
    }

    /// The counter starts again at zero, where the drum stands now.
    pub(crate) fn restart(&mut self, drum_m: f64) {
        self.shift -= self.true_counts(drum_m);
        self.held_counts = None;
    }

    #[allow(clippy::cast_possible_truncation)]
    fn true_counts(&self, drum_m: f64) -> i64 {
        let counts = (drum_m * self.counts_per_metre + self.phase).floor() as i64;
        counts.wrapping_add(self.shift)
    }

    /// Counter value; the low 16 bits of the count.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn encoder(
        &mut self,
        drum_m: f64,
        fault: &mut EncoderFault,
        noise: &mut Noise,
        passed_s: f64,
    ) -> u16 {
        let counts = self.true_counts(drum_m);
        if let Some((kind, held)) = self.held_counts
            && kind != *fault
        {
            // The counter continues from its value at the fault, like a real one.
            let shown = match kind {
                EncoderFault::Reversed => 2 * held - counts,
                _ => held,
            };
            self.shift += shown - counts;
            self.held_counts = None;
        }
        let counts = self.true_counts(drum_m);
        let shown = match *fault {
            EncoderFault::None => counts,
            EncoderFault::Floating => {
                let (_, held) = self.held_counts.get_or_insert((*fault, counts));
                let most = FLOATING_HZ * passed_s;
                *held += ((2.0 * noise.uniform() - 1.0) * most).round() as i64;
                *held
            }
            EncoderFault::Glitch(by) => {
                *fault = EncoderFault::None;
                counts + i64::from(by)
            }
            kind @ (EncoderFault::Stuck | EncoderFault::Disconnected | EncoderFault::Reversed) => {
                let held = self.held_counts.get_or_insert((kind, counts)).1;
                match kind {
                    EncoderFault::Reversed => 2 * held - counts,
                    EncoderFault::Disconnected => held + i64::from(noise.bit()),
                    _ => held,
                }
            }
        };
        shown as u16
    }

    fn adc(&mut self, tension_n: f64, now_s: f64, fault: &CableFaults) -> u16 {
        let s = &self.sensor;
        let noise_n = self.noise * s.noise_n * fault.tension_noise_factor;
        if fault.tension_drift_n_per_s != 0.0 {
            let since = self.drift_since_s.get_or_insert(now_s);
            self.drift_n += fault.tension_drift_n_per_s * (now_s - *since);
            *since = now_s;
        } else {
            self.drift_since_s = None;
            self.drift_n = 0.0;
        }
        // The bridge saturates; its noise and its offset are added behind it.
        let drift_n = self.drift_n + s.drift.zero_n(now_s);
        let sensed = tension_n.min(s.max_n) + noise_n + fault.tension_offset_n + drift_n;
        let voltage = sensed / s.gain_n_per_v + s.zero_v;
        let pull_up = match fault.tension {
            TensionFault::Open => Some(super::open::WIRED_OHM),
            TensionFault::OpenWith(ohm) => Some(ohm.max(1)),
            _ => None,
        };
        let passed_s = (now_s - self.read_s).max(0.0);
        // A connected sensor drives the pin at once; only an open input settles slowly.
        self.pin_v = match pull_up {
            Some(ohm) => super::open::open_v(self.pin_v, f64::from(ohm), passed_s),
            None => voltage,
        };
        self.read_s = now_s;
        let share = (self.pin_v / ADC_REFERENCE_V).clamp(0.0, 1.0);
        // The converter's last step is never reached: 16 x 4095 = 65 520 of 65 536.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let reading = (share * ADC_STEPS_PER_REFERENCE)
            .min(f64::from(ADC_FULL_SCALE))
            .round() as u16;
        if fault.tension != TensionFault::Frozen {
            self.held_adc = None;
        }
        match fault.tension {
            TensionFault::None | TensionFault::Open | TensionFault::OpenWith(_) => reading,
            TensionFault::Short => 0,
            TensionFault::Frozen => *self.held_adc.get_or_insert(reading),
        }
    }

    /// Reads encoder and tension sensor; with fresh noise, or with that of the reading before.
    pub(crate) fn read(
        &mut self,
        drum_m: f64,
        tension_n: f64,
        now_s: f64,
        fault: &mut CableFaults,
        noise: &mut Noise,
        fresh: bool,
    ) -> (u16, u16) {
        let passed_s = now_s - self.read_s;
        let counts = self.encoder(drum_m, &mut fault.encoder, noise, passed_s);
        if fresh {
            // In every case, so that a fault on one sensor does not change the others' noise.
            self.noise = noise.normal();
        }
        (counts, self.adc(tension_n, now_s, fault))
    }
}

/// Seeded noise: the same seed gives the same run, bit by bit.
#[derive(Debug, Clone)]
pub(crate) struct Noise(ChaCha8Rng);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Uniform over (0, 1), never an end.
    #[allow(clippy::cast_precision_loss)]
    pub(crate) fn uniform(&mut self) -> f64 {
        // Half a step up: neither 0 nor 1, so that the logarithm in `normal` stays finite.
        ((self.0.next_u64() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }

    /// Standard normal (Box and Muller 1958).
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(self.uniform())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }

    fn bit(&mut self) -> bool {
        self.0.next_u32() & 1 == 1
    }
}
