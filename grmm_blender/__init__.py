"""The Blender half of the extension: what operators, panels and Blender's events work with.

From the ground up; each room uses only those above it. `grmm_core` is reached by relative import only, and nothing here
imports torch or numba, or knows the operators. What is registered stands in the table of the extension's entry point.

``compat`` ``windows`` ``events``        differences between Blender versions, found by feature; redrawing; Blender's events
``declare``                             Blender's properties and operators by what users see of them
``wrapper``                             Python objects that stand for one object of Blender's
``linking``                             collections that new objects go to
``progress_bar`` ``width``              progress bars in panels; sentences in lines that fit a panel
``latest_request`` ``pace``             work on a thread for the latest of many requests; what holds the frame rate
``session_host``                        the one model session of this process (in-process, or a worker interpreter)
``rig``                                 the avatar as a Python object; head mesh, armature, shape keys, drivers, controls
``splats``                              splat clouds: imported splat files and other projects' avatars
``hair``                                strands as Blender's Curves object, read and made; the choice of grooms with pictures
``motion``                              face bones, Look At, blinking and breathing
``properties``                          settings of avatars on Blender's objects
``scene``                               a scene as plain values: avatars, clouds, meshes, world, cameras; walked once
``engine``                              the GRMM render engine: stills, animations, the rendered viewport
``staging``                             where new avatars stand, cameras that frame them
``viewport``                            drawing splats in solid and material preview viewports
``composite``                           scenes of another engine with avatars in them
``portraits`` ``sheet``                 small pictures of one avatar; tiles of many with captions
``poses`` ``performance``               the pose library; keys of recorded performances
``exporting``                           from the scene to what the core's writers take
``runtime_install``                     torch in a folder of the extension's own
``diagnostics`` ``preferences``         what runs where, in words; the extension's preferences
``preset_menus`` ``panels``             user interface
``command_job``                         a command of `grmm` in a process of its own
``fitting`` ``recordings``              avatars from photos, performances from videos and voices: job, panel
``menus`` ``translations``              menus of the viewport; labels in other languages
``moved_files``                         names of files in what is saved elsewhere or appended
``handlers``                            frame change, edits, load and save
"""
