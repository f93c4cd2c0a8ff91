import json,sys
import numpy as np
for f in sys.argv[1:]:
  for l in open(f):
    r=json.loads(l)
    print(f"--- {r['seed']} {r['family']} {r['path']} views {r['views']} photons {r['photons'] and round(r['photons'])} sart {r['sart'][0]:.4f}@{r['sart'][1]} fast {r['fast']/r['sart'][0]:.2f}x")
    for f_ in (2,1):
        a=[x for x in r['rows'] if x['factor']==f_ and x['which']=='all']; b=[x for x in r['rows'] if x['factor']==f_ and x['which']=='part']
        m=min(x['err'] for x in a); cm=min(x['cv'] for x in b)
        print(f_, "noise", f"{b[0]['cvnoise']:.2e}", "cvmin %.3f"%cm, "best/sart %.2f"%(m/r['sart'][0]))
        print("   e     ", " ".join(f"{x['e']:6d}" for x in a))
        print("   err/m ", " ".join(f"{x['err']/m:6.2f}" for x in a))
        print("   part/m", " ".join(f"{x['err']/m:6.2f}" for x in b))
        print("   chi   ", " ".join(f"{x['chi']:6.3f}" for x in a))
        print("   cv-min", " ".join(f"{x['cv']-cm:6.3f}" for x in b))
        print("   cvu/mi", " ".join(f"{x['cvu']/min(y['cvu'] for y in b):6.3f}" for x in b))
