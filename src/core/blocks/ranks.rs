//! Blocks shared by the ranks of an MPI run: rank 0 hands them out on demand, then every rank tells all
//! others what it computed (feature `mpi`).
//!
//! On rank 0 only the calling thread speaks MPI; on the others whichever thread wants a block, one at a
//! time: `MPI_THREAD_SERIALIZED`.

use super::packed::{Columns, opened, sealed};
use super::work::{Transport, Work};
use crate::core::parallel::prelude::*;
use crate::error::{Error, Result};
use mpi::Threading;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, Destination, Root, Source};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// Tags of a rank that asks for a block, and of the answer.
const ASK: i32 = 1;
const ANSWER: i32 = 2;
/// The answer when all blocks are handed out.
const NO_MORE: u64 = u64::MAX;
/// Bytes of a message at most: MPI counts in 31 bits.
const MESSAGE: usize = 1 << 30;
/// How long rank 0 sleeps between looks for requests: little beside a block's tenth of a second.
const POLL: Duration = Duration::from_micros(200);
/// Variables that launchers set for every process they start: Open MPI's mpirun, and those that speak
/// PMIx or PMI (Slurm, MPICH).
const LAUNCHED: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK"];

/// The processes of an MPI run.
pub struct Ranks {
    /// This process, from 0.
    pub rank: usize,
    /// Number of processes.
    pub size: usize,
}

impl Ranks {
    /// Starts MPI if a launcher started this process; the environment ends MPI when dropped.
    ///
    /// # Errors
    /// MPI has been started before, or cannot serve several threads in turn.
    pub fn launched() -> Result<Option<(Universe, Self)>> {
        if LAUNCHED.iter().all(|name| std::env::var_os(name).is_none()) {
            return Ok(None);
        }
        let (universe, provided) = mpi::initialize_with_threading(Threading::Serialized)
            .ok_or_else(|| Error::Failed("MPI was started twice".into()))?;
        if provided < Threading::Serialized {
            return Err(Error::Failed(
                "this MPI serves one thread only; expected MPI_THREAD_SERIALIZED, which Open MPI and MPICH have".into(),
            ));
        }
        let world = universe.world();
        let number = |n: i32| usize::try_from(n).unwrap_or(0);
        let ranks = Self {
            rank: number(world.rank()),
            size: number(world.size()),
        };
        Ok(Some((universe, ranks)))
    }

    /// Ends all processes of the run, which would wait for this one for ever.
    pub fn abort(&self, exit_code: u8) -> ! {
        SimpleCommunicator::world().abort(exit_code.into())
    }

    /// Refuses to go on if `key`, a hash of all that a run depends on, is another than on rank 0.
    ///
    /// # Errors
    /// It is.
    pub fn expect_same(&self, key: &str) -> Result<()> {
        let mut first = *blake3::hash(key.as_bytes()).as_bytes();
        let own = first;
        let world = SimpleCommunicator::world();
        world.process_at_rank(0).broadcast_into(&mut first[..]);
        if first == own {
            return Ok(());
        }
        Err(Error::Failed(format!(
            "rank {} has other inputs, options or another program than rank 0; start the same program on the same files everywhere",
            self.rank
        )))
    }

    /// Sends what rank `from` has to everyone.
    fn broadcast(from: usize, bytes: &mut Vec<u8>) {
        let world = SimpleCommunicator::world();
        let root = world.process_at_rank(i32::try_from(from).unwrap_or(0));
        let mut length = bytes.len() as u64;
        root.broadcast_into(&mut length);
        bytes.resize(usize::try_from(length).unwrap_or(0), 0);
        for part in bytes.chunks_mut(MESSAGE) {
            root.broadcast_into(part);
        }
    }
}

/// Where a rank gets its next block.
struct Desk {
    count: usize,
    /// Blocks handed out so far; of rank 0.
    given: AtomicUsize,
    /// Whether rank 0 said that there are no more; of the others.
    over: Mutex<bool>,
}

impl Desk {
    fn at_rank_0(&self) -> Option<usize> {
        let next = self.given.fetch_add(1, Ordering::Relaxed);
        (next < self.count).then_some(next)
    }

    fn elsewhere(&self) -> Option<usize> {
        let mut over = self.over.lock().unwrap_or_else(PoisonError::into_inner);
        if *over {
            return None;
        }
        let world = SimpleCommunicator::world();
        let desk = world.process_at_rank(0);
        desk.send_with_tag(&0u64, ASK);
        let (answer, _) = desk.receive_with_tag::<u64>(ANSWER);
        let next = usize::try_from(answer).ok().filter(|b| *b < self.count);
        *over = next.is_none();
        next
    }

    /// Answers the other ranks until each has heard that there is no more, and `done` says that rank 0 is
    /// done itself.
    fn serve(&self, others: usize, done: &AtomicBool) {
        let world = SimpleCommunicator::world();
        let mut dismissed = 0;
        while dismissed < others || !done.load(Ordering::Acquire) {
            let Some(asked) = world.any_process().immediate_probe_with_tag(ASK) else {
                std::thread::sleep(POLL);
                continue;
            };
            let who = world.process_at_rank(asked.source_rank());
            let _ = who.receive_with_tag::<u64>(ASK);
            let next = self.at_rank_0();
            dismissed += usize::from(next.is_none());
            who.send_with_tag(&next.map_or(NO_MORE, |b| b as u64), ANSWER);
        }
    }
}

/// Sets a flag when dropped, be it by a panic.
struct Signal<'a>(&'a AtomicBool);

impl Drop for Signal<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// Computes blocks as long as there are some.
fn compute(
    work: &Work<'_>,
    found: &[OnceLock<Columns>],
    next: impl Fn() -> Option<usize> + Sync + Send,
) {
    (0..work.count)
        .into_par_iter()
        .with_max_len(1)
        .for_each(|_| {
            if let Some(block) = next() {
                // handed out once
                let _ = found[block].set((work.compute)(block));
            }
        });
}

impl Transport for Ranks {
    fn enter(&self, _: &str) {}

    fn results(&self, work: &Work<'_>) -> Vec<Columns> {
        let mut found: Vec<OnceLock<Columns>> = (0..work.count).map(|_| OnceLock::new()).collect();
        let desk = Desk {
            count: work.count,
            given: AtomicUsize::new(0),
            over: Mutex::new(false),
        };
        if self.rank == 0 {
            let done = AtomicBool::new(false);
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    let _signal = Signal(&done);
                    compute(work, &found, || desk.at_rank_0());
                });
                desk.serve(self.size - 1, &done);
            });
        } else {
            compute(work, &found, || desk.elsewhere());
        }
        for rank in 0..self.size {
            let mut bytes = match rank == self.rank {
                true => listed(&found),
                false => Vec::new(),
            };
            Self::broadcast(rank, &mut bytes);
            if rank != self.rank {
                take_in(&mut found, &bytes);
            }
        }
        let all = found.into_iter().enumerate();
        all.map(|(block, c)| c.into_inner().unwrap_or_else(|| (work.compute)(block)))
            .collect()
    }
}

/// The blocks that are there: number, length and content of each.
fn listed(found: &[OnceLock<Columns>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (block, columns) in found.iter().enumerate() {
        if let Some(columns) = columns.get() {
            let content = sealed("", columns);
            bytes.extend((block as u64).to_le_bytes());
            bytes.extend((content.len() as u64).to_le_bytes());
            bytes.extend(content);
        }
    }
    bytes
}

/// Takes the blocks of [`listed`]; what is damaged stays out.
fn take_in(found: &mut [OnceLock<Columns>], bytes: &[u8]) {
    let mut rest = bytes;
    while let Some((head, after)) = rest.split_at_checked(16) {
        let number = |k: usize| {
            let bytes = head[k..k + 8].try_into().unwrap_or_default();
            usize::try_from(u64::from_le_bytes(bytes)).unwrap_or(usize::MAX)
        };
        let Some((content, after)) = after.split_at_checked(number(8)) else {
            return;
        };
        rest = after;
        if let (Some(place), Some(columns)) = (found.get_mut(number(0)), opened("", content)) {
            *place = columns.into();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_told_to_others_arrive_in_their_places() {
        let of = |present: &[usize]| -> Vec<OnceLock<Columns>> {
            let place = |b| match present.contains(&b) {
                true => OnceLock::from(vec![vec![b as u8; b]]),
                false => OnceLock::new(),
            };
            (0..5).map(place).collect()
        };
        let mut found = of(&[0, 3]);
        let bytes = listed(&of(&[1, 2, 4]));
        take_in(&mut found, &bytes);
        let all: Vec<Columns> = found
            .into_iter()
            .map(|c| c.into_inner().expect("there"))
            .collect();
        assert!((0..5).all(|b| all[b] == vec![vec![b as u8; b]]));
        let mut cut = of(&[]);
        take_in(&mut cut, &bytes[..bytes.len() - 1]);
        assert!(cut[2].get().is_some() && cut[4].get().is_none());
    }
}
