//! Everything that a record has over time, for the charts of the page: any part of it, thinned to the columns of a
//! chart. A column keeps the least and the greatest of its samples, so that no peak is lost.

use super::RecordedRun;
use crate::decode::Tick;
use mcdpr_core::robot::{Control, Robot};
use serde_json::{Map, Value, json};
use std::collections::HashMap;

/// Most columns that a viewer gets at once.
const MOST_COLUMNS: usize = 2000;

/// The traces of a run; SI, NaN where there is no value.
#[derive(Debug)]
pub struct Traces {
    /// Since the record's first instant, s; ascending.
    time_s: Vec<f64>,
    /// Named groups of traces: one for each cable or axis.
    groups: Vec<(&'static str, Vec<Vec<f64>>)>,
    about: Value,
}

impl Traces {
    /// Of a record.
    pub fn of(run: &RecordedRun, robot: &Robot) -> Self {
        let mut ticks = run.ticks();
        // As for the motion that the page draws: times of a simulated robot count from its first true state.
        let first = run.truth.first().map(|point| point.tick);
        let first = first
            .or_else(|| ticks.first().map(|tick| tick.tick))
            .unwrap_or(0);
        // Counts of 32 bits wrap; a tick from before the first one has no time.
        ticks.retain(|tick| tick.tick.wrapping_sub(first) <= u32::MAX / 2);
        ticks.sort_by_key(|tick| tick.tick.wrapping_sub(first));
        ticks.dedup_by_key(|tick| tick.tick);
        let time = |tick: u32| f64::from(tick.wrapping_sub(first)) * 1e-3;
        let truth: HashMap<u32, _> = run.truth.iter().map(|point| (point.tick, point)).collect();
        let cables = robot.cables.len();
        let each = |of: &dyn Fn(&Tick, usize) -> Option<f64>| {
            let trace = |index| {
                ticks
                    .iter()
                    .map(|tick| of(tick, index).unwrap_or(f64::NAN))
                    .collect()
            };
            (0..cables).map(trace).collect::<Vec<Vec<f64>>>()
        };
        let planned_m: Vec<Option<[f64; 3]>> = ticks
            .iter()
            .map(|tick| {
                // The plan of several motions one after another goes on where the last one ended, as the path
                // times of true states do; those of ticks begin again.
                let plan = run.plan.as_ref()?;
                let true_s = truth.get(&tick.tick).map(|point| point.path_s);
                let path_s = true_s.or(tick.path_s).filter(|path_s| *path_s > 0.0)?;
                (path_s <= plan.duration_s).then(|| plan.tool_at(path_s))?
            })
            .collect();
        let tool_m: Vec<Option<[f64; 3]>> = ticks
            .iter()
            .map(|tick| truth.get(&tick.tick).map(|point| point.tool_m))
            .collect();
        let axes = |places: &[Option<[f64; 3]>]| -> Vec<Vec<f64>> {
            let trace = |axis: usize| {
                places
                    .iter()
                    .map(|at| at.map_or(f64::NAN, |at| at[axis]))
                    .collect()
            };
            (0..3).map(trace).collect()
        };
        let off = |(at, shall): (&Option<[f64; 3]>, &Option<[f64; 3]>)| match (at, shall) {
            (Some(at), Some(shall)) => {
                let gaps = at.iter().zip(shall).map(|(a, b)| (a - b).powi(2));
                gaps.sum::<f64>().sqrt()
            }
            _ => f64::NAN,
        };
        let errors = tool_m.iter().zip(&planned_m).map(off).collect();
        let groups = vec![
            ("tool_m", axes(&tool_m)),
            ("planned_tool_m", axes(&planned_m)),
            ("path_error_m", vec![errors]),
            ("lengths_m", each(&|tick, i| tick.lengths_m.get(i).copied())),
            (
                "length_errors_m",
                each(&|tick, i| Some(tick.lengths_m.get(i)? - tick.planned.get(i)?.length_m)),
            ),
            (
                "tensions_n",
                each(&|tick, i| tick.tensions_n.get(i).copied()),
            ),
            (
                "expected_n",
                each(&|tick, i| Some(tick.planned.get(i)?.tension_n)),
            ),
            (
                "currents_a",
                each(&|tick, i| tick.currents_a.get(i).copied()),
            ),
            (
                "path_s",
                vec![
                    ticks
                        .iter()
                        .map(|tick| tick.path_s.unwrap_or(f64::NAN))
                        .collect(),
                ],
            ),
        ];
        let held = robot
            .cables
            .iter()
            .map(|cable| cable.control == Control::Tension);
        Self {
            time_s: ticks.iter().map(|tick| time(tick.tick)).collect(),
            groups,
            about: json!({
                // A board's run is drawn as planned, over its path time.
                "clock": if run.truth.is_empty() { "path" } else { "record" },
                "held": held.collect::<Vec<_>>(),
                "tension_min_n": robot.limits.tension_min_n,
                "tension_max_n": robot.limits.tension_max_n,
            }),
        }
    }

    /// The part that a page asks for in words: two times, s, and a number of columns.
    ///
    /// # Errors
    /// That these are no such numbers.
    pub fn asked(&self, times: [&str; 2], columns: &str) -> Result<Value, String> {
        let numbers = times.map(|text| text.parse::<f64>().ok().filter(|at| at.is_finite()));
        let ([Some(from_s), Some(to_s)], Ok(columns)) = (numbers, columns.parse()) else {
            return Err("a part is FROM/TO/COLUMNS: two times in s and a whole number".to_owned());
        };
        Ok(self.part(from_s, to_s, columns))
    }

    /// The part between two times, s, in at most this many columns: each with the least and the greatest of its
    /// samples, or the samples themselves if there are no more of them. One sample more at both ends.
    pub fn part(&self, from_s: f64, to_s: f64, columns: usize) -> Value {
        let columns = columns.clamp(1, MOST_COLUMNS);
        let first = self
            .time_s
            .partition_point(|at| *at < from_s)
            .saturating_sub(1);
        let last = self.time_s.partition_point(|at| *at <= to_s);
        let last = (last + 1).min(self.time_s.len()).max(first);
        let times = self.time_s.get(first..last).unwrap_or_default();
        let each = times.len().div_ceil(columns).max(1);
        let mut groups = Map::new();
        for (name, traces) in &self.groups {
            let part = |trace: &Vec<f64>| {
                let samples = trace.get(first..last).unwrap_or_default();
                let end = |pick: fn(f64, f64) -> f64| -> Vec<Option<f64>> {
                    // `min` and `max` leave NaN out; a column of nothing else has no value.
                    let columns = samples.chunks(each);
                    let ends = columns.map(|column| column.iter().copied().fold(f64::NAN, pick));
                    ends.map(|value| value.is_finite().then(|| rounded(value)))
                        .collect()
                };
                if each == 1 {
                    return json!([end(f64::min)]);
                }
                json!([end(f64::min), end(f64::max)])
            };
            let some = traces.iter().flatten().any(|value| value.is_finite());
            let parts: Vec<_> = traces.iter().filter(|_| some).map(part).collect();
            groups.insert((*name).to_owned(), json!(parts));
        }
        let middles = times.chunks(each).map(|column| {
            let ends = column.first().zip(column.last());
            ends.map_or(0.0, |(a, b)| rounded(0.5 * (a + b)))
        });
        let mut answer = self.about.clone();
        answer["duration_s"] = json!(self.time_s.last());
        answer["samples_per_column"] = json!(each);
        answer["time_s"] = json!(middles.collect::<Vec<_>>());
        answer["traces"] = Value::Object(groups);
        answer
    }
}

/// Seven decimals, as the record has for viewers.
fn rounded(value: f64) -> f64 {
    (value * 1e7).round() * 1e-7
}

#[cfg(test)]
mod tests {
    use super::*;

    fn traces() -> Traces {
        let time_s: Vec<_> = (0..10_000).map(|k| f64::from(k) * 1e-3).collect();
        let mut tension: Vec<_> = time_s.iter().map(|at| 5.0 + at).collect();
        tension[4321] = 99.0;
        tension[6000] = f64::NAN;
        let missing = vec![f64::NAN; time_s.len()];
        Traces {
            time_s,
            groups: vec![("tensions_n", vec![tension]), ("tool_m", vec![missing])],
            about: json!({}),
        }
    }

    fn numbers(value: &Value) -> Vec<f64> {
        value
            .as_array()
            .unwrap()
            .iter()
            .filter_map(Value::as_f64)
            .collect()
    }

    #[test]
    fn a_column_keeps_its_peak_and_the_answer_is_bounded() {
        let part = traces().part(0.0, 10.0, 100);
        let tension = &part["traces"]["tensions_n"][0];
        let (low, high) = (numbers(&tension[0]), numbers(&tension[1]));
        assert_eq!((low.len(), high.len()), (100, 100));
        assert!(high.contains(&99.0) && !low.contains(&99.0));
        assert_eq!(part["samples_per_column"], 100);
        assert!(
            part["traces"]["tool_m"].as_array().unwrap().is_empty(),
            "nothing was measured"
        );
        let all = traces().part(0.0, 10.0, usize::MAX);
        assert!(numbers(&all["time_s"]).len() <= MOST_COLUMNS);
    }

    #[test]
    fn a_short_part_has_its_samples_and_one_more_at_both_ends() {
        let part = traces().part(4.32, 4.322, 100);
        assert_eq!(
            numbers(&part["time_s"]),
            [4.319, 4.32, 4.321, 4.322, 4.323].map(rounded)
        );
        let tension = part["traces"]["tensions_n"][0].as_array().unwrap();
        assert_eq!(tension.len(), 1, "no band");
        assert_eq!(tension[0][2], 99.0);
        let gap = traces().part(5.999, 6.001, 100);
        assert!(gap["traces"]["tensions_n"][0][0][2].is_null());
        for (from_s, to_s) in [(20.0, 30.0), (-5.0, -4.0), (3.0, 2.0), (f64::NAN, 1.0)] {
            traces().part(from_s, to_s, 10);
        }
    }
}
