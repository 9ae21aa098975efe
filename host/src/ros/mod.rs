//! The robot for ROS 2: topics from what viewers see, services that give orders.
//!
//! | module | what it is for |
//! |---|---|
//! | `pipe` | the process that speaks DDS (`mcdpr-ros`, a crate of its own), and bounded queues to it |
//! | `topics` | the robot's state as messages, 50 times a second |
//! | `calls` | the services, and their requests as orders |
//! | `actions` | goals with feedback, result and cancelling: the actions |
//! | `goals` | places and tasks on their way to the thread that moves the robot |
//!
//! DDS is in another process: nothing that it does can hold the thread that feeds the board. What does not go into
//! its queue is dropped; a process that ends is started again, and the robot goes on meanwhile.

mod actions;
mod calls;
mod goals;
mod pipe;
mod topics;

pub(crate) use actions::Actions;
pub(crate) use calls::Desk;
pub(crate) use goals::{Ending, Goal, Goals, Wish};
pub(crate) use pipe::{Pipe, Program};
pub(crate) use topics::Topics;
