//! Recorded runs that the page opens.

use super::Stage;
use crate::Settings;
use mcdpr_core::robot::Robot;
use mcdpr_twin::asked::text;
use mcdpr_twin::record::RecordedRun;
use mcdpr_twin::record::judge::{Judgement, judge};
use mcdpr_twin::record::past::{self, anchors_m};
use mcdpr_twin::record::traces::Traces;
use serde_json::{Value, json};

/// Most records that are kept; a new one takes the place of the oldest.
const MOST_RECORDS: usize = 4;
/// Most bytes of a record.
pub(crate) const MOST_BYTES: usize = 64 << 20;

/// A record that was read.
#[derive(Debug)]
pub(crate) struct Opened {
    name: String,
    /// Without the bytes of its line.
    run: RecordedRun,
    robot: Robot,
    judgement: Judgement,
    traces: Traces,
}

impl Opened {
    /// Reads a record; `name` is that of its file.
    fn read(name: String, bytes: &[u8]) -> Result<Self, String> {
        let words = |error: String| format!("{name}: {error}");
        let run = RecordedRun::parse(bytes, name.clone().into());
        let mut run = run.map_err(|error| words(error.to_string()))?;
        let robot = run.designed_robot();
        let robot = robot.map_err(|error| words(error.plain_words()))?;
        let (judgement, traces) = (judge(&run, &robot), Traces::of(&run, &robot));
        // They are most of it, and nothing asks for them again.
        run.frames = Vec::new();
        Ok(Self {
            name,
            run,
            robot,
            judgement,
            traces,
        })
    }
}

impl Stage<'_> {
    /// Opens the record that the page has sent; returns its name in the list.
    pub(super) fn open_record(&self, message: &Value) -> Result<Value, String> {
        let name = text(message, "name")?;
        let bytes = self.host.file().ok_or("no file has come with this order")?;
        if bytes.len() > MOST_BYTES {
            return Err(format!(
                "{name} has {} MB, a page opens {} MB at most: use mcdpr report",
                bytes.len() >> 20,
                MOST_BYTES >> 20
            ));
        }
        let mut records = self.kept.records.borrow_mut();
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        let own: String = name.chars().filter(|c| plain(*c)).take(60).collect();
        // Every record of the program is called run.mcap.
        let numbered = (1..).map(|number| match number {
            1 => own.clone(),
            number => format!("{number}-{own}"),
        });
        let mut free = numbered.filter(|name| records.iter().all(|opened| opened.name != *name));
        let name = free.next().unwrap_or_default();
        let opened = Opened::read(name.clone(), &bytes)?;
        if records.len() >= MOST_RECORDS {
            records.remove(0);
        }
        records.push(opened);
        Ok(json!({ "name": name }))
    }

    /// What the page asks of its records, by the paths of the program's server.
    pub(super) fn document(&self, message: &Value) -> Result<Value, String> {
        let records = self.kept.records.borrow();
        let parts: Vec<_> = text(message, "path")?.split('/').skip(1).collect();
        let find = |name: &str| {
            let found = records.iter().find(|opened| opened.name == name);
            found.ok_or_else(|| format!("there is no record {name}"))
        };
        match parts[..] {
            ["runs"] => {
                // The latest first, as in the program's list.
                let names: Vec<_> = records.iter().rev().map(|opened| &opened.name).collect();
                Ok(json!({ "folder": "this page: open a record", "runs": names }))
            }
            ["runs", name] => {
                let opened = find(name)?;
                let here_m = anchors_m(self.model.robot());
                let (run, robot) = (&opened.run, &opened.robot);
                Ok(past::message(name, run, robot, &opened.judgement, &here_m))
            }
            ["runs", name, "traces", from_s, to_s, columns] => {
                find(name)?.traces.asked([from_s, to_s], columns)
            }
            _ => Err("there is no such document".to_owned()),
        }
    }

    /// Puts the robot of a record on the stage, where it waits at home.
    pub(super) fn take_robot(&self, message: &Value) -> Result<Value, String> {
        let name = text(message, "name")?;
        let records = self.kept.records.borrow();
        let opened = records.iter().find(|opened| opened.name == name);
        let opened = opened.ok_or_else(|| format!("there is no record {name}"))?;
        let file = opened.run.scenario.robot.first();
        let file = file.ok_or("the record has no robot file")?;
        self.replace(Settings {
            name: opened.robot.name.clone(),
            text: file.text.clone(),
            tool_m: Some(opened.robot.tool.home_in_world_m.into()),
            ..self.settings.clone()
        })?;
        Ok(Value::Null)
    }
}
