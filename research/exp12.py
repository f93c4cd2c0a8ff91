import sys; sys.path.insert(0,"/tmp/e60")
from exp9 import *
import exp11
for l in open(sys.argv[1]):
    r=json.loads(l)
    if r["seed"]<int(sys.argv[2]): continue
    s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    print(f"{r['seed']} {r['family']:9s} n{r['n']} v{len(A)} ph {r['photons'] and round(r['photons'])} sart@{r['sart'][1]} fast/sart {r['fast']/r['sart'][0]:.2f}",end=" ")
    t=time.perf_counter(); sart(A,p,iterations=1,relaxation=1.0,nonnegative=True); tp=time.perf_counter()-t
    t=time.perf_counter(); v=fast(A,p,photons=s.photons); tf=(time.perf_counter()-t)/tp
    tm={}; errs=[]
    x,rho=newfast(A,p,s.photons,passes=3,cb=lambda x: errs.append(s.error(x)/r['sart'][0]),times=tm)
    print("fast t",round(tf,1),"| OS rho %.1f"%np.log2(rho)," ".join("%.2f"%e for e in errs),{k:round(v/tp,2) for k,v in tm.items()},flush=True)
