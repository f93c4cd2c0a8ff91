import sys; sys.path.insert(0,"/tmp/e60")
from exp9 import *
import exp9
chs=[]
_one=Minimiser.one_pass
def one(self,notify=None):
    r=_one(self,notify); chs.append(self.change); return r
Minimiser.one_pass=one
for f in sys.argv[1:]:
  for l in open(f):
    r=json.loads(l); s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    errs=[]; chs.clear()
    x,rho=newfast(A,p,s.photons,passes=9,cb=lambda x: errs.append(s.error(x)/r['sart'][0]))
    print(f"{r['seed']} {r['family']:9s} n{r['n']} v{len(A)} ph {r['photons'] and round(r['photons'])} sart@{r['sart'][1]} fast/sart {r['fast']/r['sart'][0]:.2f} rho {np.log2(rho):.1f} "," ".join("%.2f"%e for e in errs)," | "," ".join("%.3f"%c for c in chs[-9:]),flush=True)
