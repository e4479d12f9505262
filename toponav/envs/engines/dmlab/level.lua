-- One maze of toponav as a level of DeepMind Lab. Part of toponav, MIT licence.
--
-- Settings (`config` of deepmind_lab.Lab), which say how the maze looks:
--   regions        rows of a text level's variations layer, one letter an open cell
--   textureSeed    draws the regions' walls and floors, and the decals
--   decals         share of wall faces with a picture, in [0, 1]
-- Property `scene`, to be written before each reset; lines of a word and its values:
--   map <name>     a name that no other text has
--   row <text>     the text level, from north to south, one line a row
--   start <x> <y> <yaw>, goal <x> <y>, apple <x> <y>
-- Property `respawn`, `<x> <y> <yaw>`: where the goal puts the agent.
-- Observation POSE: x, y and yaw of the agent, as the server has them.

local game = require 'dmlab.system.game'
local map_maker = require 'dmlab.system.map_maker'
local tensor = require 'dmlab.system.tensor'
local random = require('common.random')(map_maker:randomGen())
local decals = require('themes.decals').decals
local textures = require('themes.texture_sets').MISHMASH

-- Above the floor, in map units; things and agents drop to it.
local THING_HEIGHT, START_HEIGHT = 30, 25
local GOAL_ID = 1
-- item types of the engine: 9 is worth its quantity, 10 also ends the map
local ITEMS = {
    apple_reward = {name = 'Apple', classname = 'apple_reward',
                    model = 'models/apple.md3', quantity = 1, type = 9},
    goal = {name = 'Goal', classname = 'goal',
            model = 'models/goal_object_02.md3', quantity = 10, type = 10},
}

local api = {}
local look = {}
local scene
local isNew
local taken

local function theme()
  local walls = random:shuffle(textures.wall)
  local floors = random:shuffle(textures.floor)
  local variations = {}
  local drawn = 0
  local theme = {}

  function theme:mazeVariation(letter)
    if not variations[letter] then
      local wall = walls[drawn % #walls + 1]
      variations[letter] = {
          floor = floors[drawn % #floors + 1],
          ceiling = textures.ceiling[1],
          wallN = wall, wallE = wall, wallS = wall, wallW = wall,
          riser = wall, tread = wall,
      }
      drawn = drawn + 1
    end
    return variations[letter]
  end

  function theme:placeWallDecals(places)
    local placed = {}
    random:shuffleInPlace(places)
    for i = 1, math.floor(look.decals * #places + 0.5) do
      placed[i] = {index = places[i].index, decal = random:choice(decals)}
    end
    return placed
  end

  return theme
end

function api:init(settings)
  look.regions = settings.regions
  look.seed = tonumber(settings.textureSeed)
  look.decals = tonumber(settings.decals)
end

function api:writeProperty(key, value)
  if key == 'respawn' then
    scene.start = value
    return true
  elseif key ~= 'scene' then
    return nil
  end
  scene = {rows = {}, apples = {}}
  isNew, taken = true, {}
  for word, rest in value:gmatch('(%l+) ([^\n]*)') do
    if word == 'row' then
      table.insert(scene.rows, rest)
    elseif word == 'apple' then
      table.insert(scene.apples, rest)
    else
      scene[word] = rest
    end
  end
  return true
end

function api:readProperty(key)
  return nil
end

function api:listProperty(key, callback)
  return false
end

function api:nextMap()
  if not isNew then
    return ''  -- the goal restarts the map that is there
  end
  isNew = false
  map_maker:randomGen():seed(look.seed)
  map_maker:mapFromTextLevel{
      entityLayer = table.concat(scene.rows, '\n'),
      variationsLayer = look.regions,
      mapName = scene.map,
      allowBots = false,
      skyboxTextureName = 'map/lab_games/sky/lg_sky_03',
      theme = theme(),
      callback = function() return {} end,
  }
  return scene.map
end

function api:updateSpawnVars(vars)
  if vars.classname == 'info_player_start' then
    local x, y, yaw = scene.start:match('(%S+) (%S+) (%S+)')
    vars.origin = ('%s %s %d'):format(x, y, START_HEIGHT)
    vars.angle = yaw
    vars.randomAngleRange = '0'
  end
  return vars
end

local function thing(class, place, id)
  return {
      classname = class,
      model = ITEMS[class].model,
      origin = place .. ' ' .. THING_HEIGHT,
      id = tostring(id),
      wait = '-1',
  }
end

function api:extraEntities()
  local things = {}
  if scene.goal then
    table.insert(things, thing('goal', scene.goal, GOAL_ID))
  end
  for number, place in ipairs(scene.apples) do
    if not taken[GOAL_ID + number] then
      table.insert(things, thing('apple_reward', place, GOAL_ID + number))
    end
  end
  return things
end

function api:createPickup(class)
  return ITEMS[class]
end

function api:pickup(id)
  taken[id] = true
  return -1
end

function api:hasEpisodeFinished()
  return false  -- the environment has a clock of its own
end

function api:customObservationSpec()
  return {{name = 'POSE', type = 'Doubles', shape = {3}}}
end

function api:customObservation()
  local info = game:playerInfo()
  return tensor.DoubleTensor{info.pos[1], info.pos[2], info.angles[2]}
end

return api
