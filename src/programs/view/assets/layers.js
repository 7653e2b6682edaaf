// The layers one can look at: name, key, the textures each needs, and what its colours mean.

const bar = (colours, from, to) => ({ colours, from, to });
const HEAT = ['#000005', '#570f6e', '#ba3654', '#fa8c0a', '#fcffa3'];

export const LAYERS = [
  { id: 'final', name: 'Final', key: '1', textures: [], about: 'Albedo × irradiance / π, reflections and emission. While it moves, reflections come from panoramas of the rooms; at rest they are traced.' },
  { id: 'albedo', name: 'Albedo', key: '2', textures: [], about: 'Diffuse reflectance, shown in sRGB, without light.' },
  { id: 'roughness', name: 'Roughness', key: '3', textures: [], about: 'Roughness R; the width of highlights grows with R².', legend: bar(['#000', '#fff'], '0 smooth', '1 rough') },
  { id: 'irradiance', name: 'Irradiance', key: '4', textures: [], about: 'Light arriving per area, E / π: what a white wall would show.' },
  { id: 'radiance', name: 'Radiance', key: '5', textures: ['radiance'], about: 'Light leaving the surface as the photographs show it, highlights suppressed.' },
  { id: 'emission', name: 'Emission', key: '6', textures: [], about: 'Light that surfaces send out themselves.' },
  { id: 'confidence', name: 'Albedo error', key: '7', textures: ['confidence'], about: 'Standard error of the albedo (logarithmic). Grey: no photograph sees it.', legend: bar(HEAT, '0.001 sure', '1 unsure') },
  { id: 'roughness-confidence', name: 'Roughness error', key: '8', textures: ['confidence'], about: 'Standard error of the roughness (logarithmic). Grey: not observed.', legend: bar(HEAT, '0.001 sure', '1 unsure') },
  { id: 'labels', name: 'Classes', key: '9', textures: [], about: 'The class of every surface after the vote of all views.' },
  { id: 'rooms', name: 'Rooms', key: '0', textures: [], about: 'The room every surface belongs to.' },
  { id: 'error', name: 'Error', key: 'x', textures: [], needsCamera: true, about: 'Mean difference between the photograph and this page’s rendering, after tone mapping. Only from a camera’s place.', legend: bar(HEAT, '0', '0.25') },
];

export const layer = (id) => LAYERS.find((l) => l.id === id);
