//! A line to a robot whose events are passed on, with the truth of a simulated robot.

use crate::events::{Level, PlanNote, RunEvent, TruthPoint};
use crate::line::SimulatedLink;
use mcdpr_core::control::{Handle, ScriptedOrder};
use mcdpr_core::link::{Direction, Link, LinkError, Note, RawFrame};
use mcdpr_simulator::TracePoint;
use std::cell::RefCell;
use std::rc::Rc;

/// Takes the events of a line.
pub trait Sink {
    /// An event.
    fn publish(&self, event: RunEvent);
    /// Whether nobody wants events: then none are made.
    fn is_empty(&self) -> bool;
}

/// The true state of a simulated robot, sampled while its time passes.
#[derive(Clone)]
pub struct TruthTap {
    link: SimulatedLink,
    cables: usize,
    kept: Option<Rc<RefCell<Vec<TracePoint>>>>,
}

impl TruthTap {
    /// Ticks between the points that are shown.
    const EVERY: u32 = 10;

    /// Starts sampling.
    #[must_use]
    pub fn new(link: SimulatedLink, cables: usize) -> Self {
        link.with(mcdpr_simulator::Simulation::record_truth);
        Self {
            link,
            cables,
            kept: Some(Rc::default()),
        }
    }

    /// Starts sampling for watchers, and stores nothing: for a robot that runs for days.
    #[must_use]
    pub fn forgetful(link: SimulatedLink, cables: usize) -> Self {
        Self {
            kept: None,
            ..Self::new(link, cables)
        }
    }

    fn show(&self, events: &impl Sink) {
        let (new, now_us) = self
            .link
            .with(|simulation| (simulation.take_trace(), simulation.now_us()));
        if !events.is_empty() {
            for point in new.iter().filter(|p| p.tick.0.is_multiple_of(Self::EVERY)) {
                events.publish(RunEvent::Truth {
                    time_us: now_us,
                    truth: TruthPoint::of(point, self.cables),
                });
            }
        }
        if let Some(kept) = &self.kept {
            kept.borrow_mut().extend(new);
        }
    }

    /// All stored samples, tick by tick.
    #[must_use]
    pub fn take(&self) -> Vec<TracePoint> {
        let new = self.link.with(mcdpr_simulator::Simulation::take_trace);
        let kept = self.kept.as_ref();
        let mut all = kept.map_or_else(Vec::new, |kept| kept.take());
        all.extend(new);
        all
    }
}

/// A line whose events a [`Sink`] takes.
pub struct Watched<'a, L, S> {
    inner: L,
    events: &'a S,
    truth: Option<TruthTap>,
    calls: u32,
    orders: Option<Handle>,
}

impl<'a, L: Link, S: Sink> Watched<'a, L, S> {
    /// Shows the traffic of `inner`.
    pub const fn new(inner: L, events: &'a S) -> Self {
        Self {
            inner,
            events,
            truth: None,
            calls: 0,
            orders: None,
        }
    }

    /// Shows the true state of the simulated robot as well.
    #[must_use]
    pub fn with_truth(mut self, tap: TruthTap) -> Self {
        self.truth = Some(tap);
        self
    }

    /// Shows the orders to this handle as well; a new run begins.
    #[must_use]
    pub fn with_orders(mut self, handle: &Handle) -> Self {
        handle.count_anew();
        self.orders = Some(handle.clone());
        self
    }

    fn show_orders(&self) {
        let new = self.orders.as_ref().map(Handle::arrived);
        for ScriptedOrder { polls, order } in new.unwrap_or_default() {
            self.events.publish(RunEvent::Order {
                time_us: self.inner.now_us(),
                looks: polls,
                order,
            });
        }
    }

    fn wire(&mut self, direction: Direction, bytes: &[u8]) {
        if !self.events.is_empty() {
            let frame = RawFrame {
                time_us: self.inner.now_us(),
                direction,
                bytes: bytes.to_vec(),
            };
            let call = self.calls;
            self.events.publish(RunEvent::Wire { call, frame });
        }
        self.calls = self.calls.wrapping_add(1);
    }
}

impl<L: Link, S: Sink> Link for Watched<'_, L, S> {
    fn goes_on(&self) -> bool {
        self.inner.goes_on()
    }

    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)?;
        self.wire(Direction::ToBoard, bytes);
        Ok(())
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let before = into.len();
        let time_us = self.inner.receive(until_us, into)?;
        self.wire(Direction::ToHost, into.get(before..).unwrap_or_default());
        if let Some(tap) = &self.truth {
            tap.show(self.events);
        }
        self.show_orders();
        Ok(time_us)
    }

    fn note(&mut self, note: Note<'_>) {
        let time_us = self.inner.now_us();
        if self.events.is_empty() {
            return;
        }
        match note {
            Note::Plan(plan) => self.events.publish(RunEvent::Plan {
                time_us,
                plan: PlanNote::of(plan),
            }),
            Note::Remark(text) => self.events.publish(RunEvent::Remark {
                time_us,
                level: Level::Info,
                text: text.to_owned(),
            }),
            Note::Picture(picture) => self.events.publish(RunEvent::Picture {
                time_us,
                picture: picture.clone(),
            }),
        }
        self.inner.note(note);
    }
}
