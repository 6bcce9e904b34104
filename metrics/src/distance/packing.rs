//! Points laid into blocks of sixteen neighbours.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, LANES};
use super::hilbert::{self, CHUNK};
use super::split::split;
use super::{Listed, Order};
use crate::error::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;

/// Points of a feed that are laid into blocks at a time, per thread.
const BATCH: usize = 4 * CHUNK;

/// Room for sixteen points.
pub(super) trait Place: Clone + Send {
    /// Sixteen points at the origin.
    const EMPTY: Self;

    /// Lays a point into a lane.
    fn set(&mut self, lane: usize, at: DVec3);
}

/// A width of coordinates that gives back the very numbers that go in.
#[allow(private_bounds, reason = "f32 and f64 only")]
pub trait Coordinate: Width {}
impl Coordinate for f32 {}
impl Coordinate for f64 {}

/// What the blocks ask of coordinates.
pub(super) trait Width: Copy + Send + Sync + std::fmt::Debug + 'static {
    const ZERO: Self;

    /// The number, which is one of these.
    fn of(number: f64) -> Self;

    fn wide(self) -> f64;

    /// The block as f64, where it is or in `room`.
    fn widened<'a>(block: &'a Block<Self>, room: &'a mut Block<f64>) -> &'a Block<f64>;
}

impl Width for f64 {
    const ZERO: Self = 0.0;

    #[inline(always)]
    fn of(number: f64) -> Self {
        number
    }

    #[inline(always)]
    fn wide(self) -> f64 {
        self
    }

    #[inline(always)]
    fn widened<'a>(block: &'a Block<Self>, _: &'a mut Block<f64>) -> &'a Block<f64> {
        block
    }
}

impl Width for f32 {
    const ZERO: Self = 0.0;

    #[inline(always)]
    fn of(number: f64) -> Self {
        number as f32
    }

    #[inline(always)]
    fn wide(self) -> f64 {
        self.into()
    }

    #[inline(always)]
    fn widened<'a>(block: &'a Block<Self>, room: &'a mut Block<f64>) -> &'a Block<f64> {
        for k in 0..LANES {
            room.x[k] = block.x[k].into();
            room.y[k] = block.y[k].into();
            room.z[k] = block.z[k].into();
        }
        room
    }
}

/// Where the points of blocks stood in the list that was laid into them.
#[derive(Debug, Clone)]
pub(super) enum Given {
    /// Per place the index in the list.
    Anywhere(Vec<u32>),
    /// Per place the index in its stretch of [`CHUNK`] points of the list.
    InChunk(Vec<u16>),
    /// Nobody will ask.
    Forgotten,
}

impl Given {
    /// As [`Given::order`], for a piece of [`CHUNK`] places or for all of them.
    pub(super) fn order_piece(&self, first: usize, values: Vec<DVec3>) -> Vec<DVec3> {
        let Self::InChunk(order) = self else {
            return self.order(values);
        };
        let mut given = vec![DVec3::ZERO; values.len()];
        for (&index, value) in order[first..].iter().zip(values) {
            given[usize::from(index)] = value;
        }
        given
    }

    /// One value per place brought to the order of the list.
    pub(super) fn order<T: Copy + Default + Send + Sync>(&self, mut values: Vec<T>) -> Vec<T> {
        match self {
            Self::Anywhere(order) => {
                let mut given = vec![T::default(); order.len()];
                for (&index, &value) in order.iter().zip(&values) {
                    given[index as usize] = value;
                }
                given
            }
            Self::InChunk(order) => {
                values.truncate(order.len());
                let chunks = values.par_chunks_mut(CHUNK).zip(order.par_chunks(CHUNK));
                chunks.for_each(|(values, order)| {
                    let mut given = [T::default(); CHUNK];
                    for (&index, &value) in order.iter().zip(&*values) {
                        given[usize::from(index)] = value;
                    }
                    values.copy_from_slice(&given[..values.len()]);
                });
                values
            }
            Self::Forgotten => values,
        }
    }
}

/// Lays a list into places, [`LANES`] points each.
pub(super) fn pack<F, P>(points: &Listed<F>, places: &mut [P]) -> Given
where
    F: Fn(usize) -> DVec3 + Sync,
    P: Place,
{
    let (count, at) = (points.count, &points.at);
    match points.order {
        Order::Any => {
            let mut order = hilbert::order(count, at);
            order
                .par_chunks_mut(CHUNK)
                .zip(places.par_chunks_mut(CHUNK / LANES))
                .for_each(|(order, places)| {
                    let points: Vec<DVec3> = order.iter().map(|&i| at(i as usize)).collect();
                    let given = order.to_vec();
                    let local = lay(&points, places);
                    for (index, local) in order.iter_mut().zip(local) {
                        *index = given[usize::from(local)];
                    }
                });
            Given::Anywhere(order)
        }
        Order::Spatial => {
            let mut order = vec![0; count];
            order
                .par_chunks_mut(CHUNK)
                .zip(places.par_chunks_mut(CHUNK / LANES))
                .enumerate()
                .for_each(|(chunk, (order, places))| {
                    let first = chunk * CHUNK;
                    let points: Vec<DVec3> = (first..first + order.len()).map(at).collect();
                    order.copy_from_slice(&lay(&points, places));
                });
            Given::InChunk(order)
        }
    }
}

/// Lays one chunk into its places: neighbours into one place, and the last point again into what is
/// left of the last. Per lane the index of its point.
fn lay<P: Place>(points: &[DVec3], places: &mut [P]) -> Vec<u16> {
    let order = split(points);
    for (place, order) in places.iter_mut().zip(order.chunks(LANES)) {
        for lane in 0..LANES {
            let index = order[lane.min(order.len() - 1)];
            place.set(lane, points[usize::from(index)]);
        }
    }
    order
}

/// Whether the order of the list is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Keep {
    Order,
    Nothing,
}

/// Points laid into places as they come, neighbours in space mostly one after the other: no list of
/// all of them need exist.
pub(super) struct Packing<P> {
    keep: Keep,
    /// Points that will come at most, as far as is known.
    most: usize,
    places: Vec<P>,
    order: Vec<u16>,
    /// What came since the last whole chunks were laid.
    waiting: Vec<DVec3>,
    count: usize,
}

impl<P: Place> Packing<P> {
    pub(super) fn new(keep: Keep, most: usize) -> Self {
        Self {
            keep,
            most,
            places: Vec::new(),
            order: Vec::new(),
            waiting: Vec::new(),
            count: 0,
        }
    }

    /// Takes the next points. An error where one is not finite.
    pub(super) fn take(&mut self, points: &[DVec3]) -> Result<()> {
        if let Some(nth) = points.iter().position(|point| !point.is_finite()) {
            let (point, at) = (points[nth], self.count + nth);
            let problem =
                format!("expected finite points, found {point} at {at}: drop such points first");
            return Err(Error::invalid("nearest-point index", problem));
        }
        self.count += points.len();
        self.waiting.extend_from_slice(points);
        if self.waiting.len() >= BATCH * rayon::current_num_threads() {
            self.lay(self.waiting.len() / CHUNK * CHUNK);
        }
        Ok(())
    }

    /// Lays the first ones that wait.
    fn lay(&mut self, count: usize) {
        let first = self.places.len();
        reserve(
            &mut self.places,
            count.div_ceil(LANES),
            self.most.div_ceil(LANES),
        );
        self.places.resize(first + count.div_ceil(LANES), P::EMPTY);
        let places = self.places[first..].par_chunks_mut(CHUNK / LANES);
        let order: Vec<Vec<u16>> = self.waiting[..count]
            .par_chunks(CHUNK)
            .zip(places)
            .map(|(points, places)| lay(points, places))
            .collect();
        if self.keep == Keep::Order {
            reserve(&mut self.order, count, self.most);
            order.iter().for_each(|order| self.order.extend(order));
        }
        self.waiting.drain(..count);
    }

    /// The places, where their points stood, and how many.
    pub(super) fn finish(mut self) -> (Vec<P>, Given, usize) {
        self.lay(self.waiting.len());
        self.places.shrink_to_fit();
        self.order.shrink_to_fit();
        let given = match self.keep {
            Keep::Order => Given::InChunk(self.order),
            Keep::Nothing => Given::Forgotten,
        };
        (self.places, given, self.count)
    }
}

/// Makes room for all at once, which on most systems costs no memory before it is written to. Where that
/// is refused, or there are more than said, room grows by eighths: twice as much, as lists grow by
/// themselves, is too much of it.
fn reserve<T>(list: &mut Vec<T>, more: usize, most: usize) {
    if list.capacity() - list.len() < more {
        let some = more.max(list.len() / 8);
        let all = some.max(most.saturating_sub(list.len()));
        if list.try_reserve_exact(all).is_err() {
            list.reserve_exact(some);
        }
    }
}
