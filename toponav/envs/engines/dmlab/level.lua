-- One maze of toponav as a level of DeepMind Lab. Part of toponav, MIT licence.
--
-- Settings (`config` of deepmind_lab.Lab), which say how the maze looks:
--   regions    rows of a text level's variations layer, one letter an open cell
--   styles     lines of a letter, the texture of its walls and that of its floor
--   pictures   lines of a cell's row and column from 1, the side of it (N, E, S, W) on which
--              a wall bears a picture, and its texture
-- Property `scene`, to be written before each reset; lines of a word and its values:
--   map <name>     a name that no other text has
--   row <text>     the text level, from north to south, one line a row
--   start <x> <y> <yaw>, goal <x> <y>, apple <x> <y>
-- Property `respawn`, `<x> <y> <yaw>`: where the goal puts the agent.
-- Observation POSE: x, y and yaw of the agent, as the server has them.

local game = require 'dmlab.system.game'
local map_maker = require 'dmlab.system.map_maker'
local tensor = require 'dmlab.system.tensor'

local SKY = 'map/lab_games/sky/lg_sky_01'
-- What a property's callback returns.
local WRITTEN, NOT_FOUND = 0, 1
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

local function texture(name)
  return {tex = name}
end

local function theme()
  local theme = {}

  function theme:mazeVariation(letter)
    local style = look.styles[letter] or look.styles.A
    local wall, floor = texture(style.wall), texture(style.floor)
    return {
        floor = floor, ceiling = floor, riser = wall, tread = wall,
        wallN = wall, wallE = wall, wallS = wall, wallW = wall,
    }
  end

  function theme:placeWallDecals(places)
    local placed = {}
    for _, place in ipairs(places) do
      local name = ('%d %d %s'):format(place.i, place.j, place.direction)
      local picture = look.pictures[name]
      if picture then
        table.insert(placed, {index = place.index, decal = texture(picture)})
      end
    end
    return placed
  end

  return theme
end

function api:init(settings)
  look.regions = settings.regions
  look.styles, look.pictures = {}, {}
  for letter, wall, floor in settings.styles:gmatch('(%u) (%S+) (%S+)') do
    look.styles[letter] = {wall = wall, floor = floor}
  end
  for place, picture in settings.pictures:gmatch('(%d+ %d+ %u) (%S+)') do
    look.pictures[place] = picture
  end
end

function api:writeProperty(key, value)
  if key == 'respawn' then
    scene.start = value
    return WRITTEN
  elseif key ~= 'scene' then
    return NOT_FOUND
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
  return WRITTEN
end

function api:nextMap()
  if not isNew then
    return ''  -- the goal restarts the map that is there
  end
  isNew = false
  -- The engine would number a map's brushes otherwise.
  map_maker:randomGen():seed(1)
  map_maker:mapFromTextLevel{
      entityLayer = table.concat(scene.rows, '\n'),
      variationsLayer = look.regions,
      mapName = scene.map,
      allowBots = false,
      skyboxTextureName = SKY,
      theme = theme(),
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
  taken[id] = true  -- and the engine pays what the item is worth
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
