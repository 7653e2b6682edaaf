//! What white paint reflects, and how far light may be short of it: the measure of the energy balance,
//! of the rooms' levels and of lamps below the ceiling.

/// White paint and how far paints called white scatter about it (ln). Cited: 0.75 to 0.9 is what
/// makers state of white interior paint.
pub(super) const WHITE: f32 = 0.82;
pub(super) const WHITE_SPREAD: f32 = 0.09;
/// The light may be short by this factor at most. Derived: A room whose walls reflect a share ρ
/// sends 1/(1 − ρ) times the lamps' light about; ρ = 0.82 leaves a sixth.
pub(super) const MOST: f32 = 6.0;
