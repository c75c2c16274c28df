-- The autopilot's side of cellwise_bridge: the measured battery goes out by a serial port, the state of charge comes
-- back as another battery (BATTn_MONITOR = 29, SERIALn_PROTOCOL = 28). Written after ArduPilot's documentation; not
-- run on an autopilot by those who wrote it.
local MEASURED, SAID = 0, 1 -- battery instances: of the power module, of this script
local CELLS = 1 -- in series: the model is of one
local PERIOD_MS = 100
local LONGEST_LINE = 200

local port = assert(serial:find_serial(0), "cellwise: no serial port for scripting")
port:begin(115200)
local line = ""

local function number(value)
  return value and string.format("%.5f", value) or "nan"
end

local function ask()
  local text = string.format("%d %s %s %s\n", millis():toint(), number(battery:current_amps(MEASURED)),
    number(battery:voltage(MEASURED) / CELLS), number(battery:get_temperature(MEASURED)))
  for k = 1, #text do
    port:write(text:byte(k))
  end
end

local function say(text)
  local soc, _, _, valid, current, voltage = text:match("^(%S+) (%S+) (%S+) (%S+) (%S+) (%S+)$")
  if not soc then
    return
  end
  local state = BattMonitorScript_State()
  state:healthy(valid == "1")
  state:voltage((tonumber(voltage) or 0) * CELLS)
  state:current_amps(tonumber(current) or 0)
  if valid == "1" then
    local percent = 100 * (tonumber(soc) or 0)
    state:capacity_remaining_pct(math.floor(math.max(0, math.min(100, percent)) + 0.5))
  end
  battery:handle_scripting(SAID, state)
end

local function hear()
  for _ = 1, port:available():toint() do
    local byte = port:read()
    if byte == 10 then
      say(line)
      line = ""
    elseif #line < LONGEST_LINE then
      line = line .. string.char(byte)
    end
  end
end

function update()
  ask()
  hear()
  return update, PERIOD_MS
end

return update()
