//! What a recorded run would take on more threads: greedy list scheduling of its pieces.
//!
//! The tape is a fork-join tree: work, loops of pieces, loops within pieces. Every piece is given
//! to the thread that is free first, in the order of the tape. Such a schedule is at most twice as
//! long as the best one (R. L. Graham, Bounds on multiprocessing timing anomalies, SIAM J. Appl.
//! Math. 17, 1969) and is what work stealing strives for (Blumofe & Leiserson, JACM 46, 1999).
//! Pieces that hold loops are scheduled more crudely: in rounds, the threads divided evenly among
//! the pieces of a round, which states more time than work stealing takes. Every loop costs its
//! beginning and end besides.

use crate::core::parallel::tape::{Mark, Tape};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Work and loops of one stage, or of one piece.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Work {
    steps: Vec<Step>,
}

#[derive(Clone, Debug, PartialEq)]
enum Step {
    /// Seconds without a loop.
    Alone(f64),
    /// Seconds of pieces without loops of their own.
    Loop(Vec<f32>),
    /// Pieces of which some hold loops.
    Nested(Vec<Work>),
}

impl Work {
    /// Seconds of processor time.
    pub fn total(&self) -> f64 {
        self.steps.iter().map(Step::total).sum()
    }

    /// Seconds outside of loops.
    pub fn alone(&self) -> f64 {
        let of = |s: &Step| if let Step::Alone(t) = s { *t } else { 0.0 };
        self.steps.iter().map(of).sum()
    }

    /// Loops, those within pieces not counted.
    pub fn loops(&self) -> usize {
        self.steps
            .iter()
            .filter(|s| !matches!(s, Step::Alone(_)))
            .count()
    }

    /// Seconds on `threads` threads of which `per_loop` are lost at every loop.
    pub fn on(&self, threads: usize, per_loop: f64) -> f64 {
        if threads <= 1 {
            return self.total();
        }
        self.steps.iter().map(|s| s.on(threads, per_loop)).sum()
    }
}

impl Step {
    fn total(&self) -> f64 {
        match self {
            Self::Alone(t) => *t,
            Self::Loop(pieces) => pieces.iter().map(|t| f64::from(*t)).sum(),
            Self::Nested(pieces) => pieces.iter().map(Work::total).sum(),
        }
    }

    fn on(&self, threads: usize, per_loop: f64) -> f64 {
        match self {
            Self::Alone(t) => *t,
            // a loop of one piece is run where it stands
            Self::Loop(pieces) if pieces.len() < 2 => self.total(),
            Self::Loop(pieces) => per_loop + listed(pieces.iter().map(|t| f64::from(*t)), threads),
            Self::Nested(pieces) => per_loop + nested(pieces, threads, per_loop),
        }
    }
}

/// The end of the last of the pieces, each given to the thread that is free first.
fn listed(pieces: impl Iterator<Item = f64>, threads: usize) -> f64 {
    let mut free: BinaryHeap<Reverse<u64>> = (0..threads).map(|_| Reverse(0)).collect();
    let mut end = 0;
    for seconds in pieces {
        // whole picoseconds, so that times have an order
        let Reverse(at) = free.pop().unwrap_or(Reverse(0));
        let done = at + (seconds * 1e12) as u64;
        end = end.max(done);
        free.push(Reverse(done));
    }
    end as f64 * 1e-12
}

/// Pieces with loops of their own: while fewer pieces than threads are left, the rest help in the
/// loops within them. In rounds: every round runs as many pieces as there are threads, or all that
/// are left, and divides the threads among them evenly.
fn nested(pieces: &[Work], threads: usize, per_loop: f64) -> f64 {
    let whole = pieces.len() / threads * threads;
    let many = listed(pieces[..whole].iter().map(Work::total), threads);
    let few = &pieces[whole..];
    let each = threads / few.len().max(1);
    let last = few.iter().map(|w| w.on(each, per_loop)).fold(0.0, f64::max);
    many + last
}

/// The stages of a tape in order of their first beginning, each with its work; work before the
/// first stage, and between stages, is under its own name `between the stages`.
pub(super) fn stages(tape: &Tape) -> Vec<(String, Work)> {
    let mut all: Vec<(String, Work)> = tape
        .stages
        .iter()
        .map(|name| (name.clone(), Work::default()))
        .collect();
    let mut at = 0;
    let mut current = None;
    while at < tape.marks.len() {
        let mut work = Work::default();
        take(&tape.marks, &mut at, &mut work.steps);
        if let Some(stage) = current {
            let (_, known): &mut (String, Work) = &mut all[stage as usize];
            known.steps.append(&mut work.steps);
        }
        // any other mark would be the end of a loop that never began: no recorder writes it
        if let Some(Mark::Stage(number)) = tape.marks.get(at) {
            current = Some(*number);
        }
        at += 1;
    }
    all.retain(|(_, work)| !work.steps.is_empty());
    all
}

/// Reads steps up to a mark that ends them: of a stage, a piece or a loop.
fn take(marks: &[Mark], at: &mut usize, steps: &mut Vec<Step>) {
    while let Some(mark) = marks.get(*at) {
        match mark {
            Mark::Work(seconds) => match steps.last_mut() {
                Some(Step::Alone(t)) => *t += f64::from(*seconds),
                _ => steps.push(Step::Alone(f64::from(*seconds))),
            },
            Mark::Fork => {
                *at += 1;
                take_loop(marks, at, steps);
            }
            Mark::Piece | Mark::Join | Mark::Stage(_) => return,
        }
        *at += 1;
    }
}

/// Reads a loop up to its end, where `at` is left.
fn take_loop(marks: &[Mark], at: &mut usize, steps: &mut Vec<Step>) {
    // before the first piece: the loop's own preparation
    take(marks, at, steps);
    let mut pieces = Vec::new();
    while marks.get(*at) == Some(&Mark::Piece) {
        *at += 1;
        let mut work = Work::default();
        take(marks, at, &mut work.steps);
        pieces.push(work);
    }
    let plain = |w: &Work| w.loops() == 0;
    steps.push(if pieces.iter().all(plain) {
        Step::Loop(pieces.iter().map(|w| w.total() as f32).collect())
    } else {
        Step::Nested(pieces)
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use Mark::{Fork, Join, Piece, Stage};

    fn tape(marks: Vec<Mark>) -> Vec<(String, Work)> {
        stages(&Tape {
            stages: vec!["a".into(), "b".into()],
            marks,
        })
    }

    #[test]
    fn serial_work_stays_and_pieces_are_divided() {
        let mut marks = vec![Stage(0), Mark::Work(1.0), Fork];
        for _ in 0..8 {
            marks.extend([Piece, Mark::Work(0.5)]);
        }
        marks.extend([Join, Stage(1), Mark::Work(2.0)]);
        let stages = tape(marks);
        let (a, b) = (&stages[0].1, &stages[1].1);
        assert_eq!((a.total(), a.alone(), a.loops()), (5.0, 1.0, 1));
        assert_eq!((a.on(1, 0.1), a.on(2, 0.0), a.on(8, 0.0)), (5.0, 3.0, 1.5));
        assert_eq!(a.on(128, 0.0), 1.5, "no more threads than pieces");
        assert!((a.on(8, 0.1) - 1.6).abs() < 1e-9, "a loop costs something");
        assert_eq!((b.total(), b.on(64, 0.1)), (2.0, 2.0));
    }

    #[test]
    fn the_longest_piece_holds_up_its_loop() {
        let mut marks = vec![Stage(0), Fork];
        for seconds in [0.25, 0.25, 0.25, 0.25, 3.0] {
            marks.extend([Piece, Mark::Work(seconds)]);
        }
        marks.push(Join);
        assert_eq!(tape(marks)[0].1.on(4, 0.0), 3.25);
    }

    #[test]
    fn threads_left_over_help_in_loops_within_pieces() {
        let mut marks = vec![Stage(0), Fork];
        for _ in 0..2 {
            marks.extend([Piece, Fork]);
            for _ in 0..4 {
                marks.extend([Piece, Mark::Work(1.0)]);
            }
            marks.push(Join);
        }
        marks.push(Join);
        let work = &tape(marks)[0].1;
        assert_eq!(work.total(), 8.0);
        assert_eq!([2, 4, 8].map(|n| work.on(n, 0.0)), [4.0, 2.0, 1.0]);
    }
}
